cp -r $FLOWN/. .
cp flights/1.csv OLD.csv
cp configs/sensors/mb1242.yaml MODEL.yaml
