"""Drivers: one plain class a device, its protocol with it; found through entry points."""
