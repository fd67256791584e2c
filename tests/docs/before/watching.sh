sed 's#sensors/mb1242.yaml#mb1242#; s#14550#'$PORT'#' configs/loopback.yaml > my_airframe.yaml
cp -r $FLOWN/. .
mv 1.mcap FLIGHT.mcap
cp configs/sensors/mb1242_in_flight.yaml MODEL.yaml
# The service, and its journal.
msp-range run my_airframe.yaml --no-record --web 0.0.0.0:$PORT 2> service.log &
journalctl() { cat service.log; }
timeout 60 sh -c "until grep -q 'web page' service.log; do sleep 0.2; done"
