# The emulated autopilot is at a UDP port, the shown one at a serial port.
sed 's#serial:.*#udpout:127.0.0.1:'$PORT'#; s#^send:#send:\n  nothing: true#' configs/quad_pallet.yaml > my_airframe.yaml
cp -r configs/sensors .
