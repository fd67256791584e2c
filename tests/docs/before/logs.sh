mkdir -p logs/copter
cp tests/data/logs/arducopter.BIN logs/copter/1.BIN
