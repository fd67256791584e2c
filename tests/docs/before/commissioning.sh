sed 's#sensors/mb1242.yaml#mb1242#; s#14550#'$PORT'#' configs/loopback.yaml > my_airframe.yaml
