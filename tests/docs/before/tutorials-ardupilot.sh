# The emulated autopilot is at a UDP port, the shown one at a serial port.
sed -i 's#serial:.*#udpout:127.0.0.1:'$PORT'#' configs/quad_pallet.yaml
