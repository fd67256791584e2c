cp -r $FLOWN/. .
mv flights/1.csv one.csv
mv flights/2.csv two.csv
for vehicle in V1 V2 V3 V4; do
  mkdir -p logs/$vehicle
  cp tests/data/logs/arducopter.BIN logs/$vehicle/1.BIN
done
