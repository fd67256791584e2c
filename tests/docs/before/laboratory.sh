echo distance_mm,ruler_cm > table.csv
for cm in 40 80 120 160 200; do
  for i in 1 2 3 4 5 6 7 8 9 10 11 12; do
    echo $((cm * 10 + i % 3 * 10 - 10)),$cm >> table.csv
  done
done
