"""Stand-ins for the devices of a BlueROV2, which speak their protocols on loopback."""
