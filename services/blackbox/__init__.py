"""Blackbox: the last seconds of one host, kept in memory and saved when something happens."""
