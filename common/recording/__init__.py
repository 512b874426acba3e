"""Recordings: MCAP files with our messages as they were on the wire, and beside them what Foxglove can draw."""
