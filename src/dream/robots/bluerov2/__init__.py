"""A real BlueROV2: ArduSub over MAVLink, a DVL A50, a camera. Needs the extra `rov`."""
