cp -r $FLOWN/. .
mv 1.mcap flight-1.mcap
mv 2.mcap flight-2.mcap
cp configs/sensors/mb1242.yaml MODEL.yaml
