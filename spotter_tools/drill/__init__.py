"""Fault drills: break one thing at a time in a running system and check health and verdict against a written plan."""
