"""Replacing a running service: a candidate speaks in the shadow, is compared with the live one, and takes over."""
