"""Drivers: one plain class a device, one file a protocol; found through entry points."""
