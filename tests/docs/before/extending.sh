cp tests/third_party/package/sonar_extras/supply_sag.py configs/sensors/mb1242.yaml .
sed '/^effects:/,$d' mb1242.yaml > model.yaml
echo 'effects: [{name: supply_sag, parameters: {sag_pct: 5}}]' >> model.yaml
echo time_s,sensor,run,true_range_cm,throttle > c.csv
for i in $(seq 1200); do
  echo $i,down,$((i / 200)),$((40 + i * 37 % 400)),0.$((i % 10)) >> c.csv
done
