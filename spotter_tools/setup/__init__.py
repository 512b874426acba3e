"""`spotter setup`: from the devices that are plugged in to a site file."""
