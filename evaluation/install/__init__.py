"""install.sh and the unit under a real systemd: a Debian made by mmdebstrap and booted by systemd-nspawn."""
