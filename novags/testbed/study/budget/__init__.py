"""An experiment within a given time: settings chosen on measured curves, for the pace of this machine."""
