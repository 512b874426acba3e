"""Replacing a running service: a candidate publishes in the shadow, is compared with the live one, and takes over."""
