sed 's#sensors/mb1242.yaml#mb1242#; s#14550#'$PORT'#' configs/loopback.yaml > my_airframe.yaml
cp -r $FLOWN/. .
cp 1.mcap flight.mcap
head -c -20000 1.mcap > cut.mcap
