"""What every host has: topics, messages, codec, config, runtime, geometry, the command line and the simulator."""
