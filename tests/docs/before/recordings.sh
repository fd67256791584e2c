# The beginning of the two tables.
data=$(realpath ../shared/data/enmt482)
rm ../shared/data
mkdir -p ../shared/data/enmt482
for name in calibration training1; do
  head -n 500 $data/$name.csv > ../shared/data/enmt482/$name.csv
done
