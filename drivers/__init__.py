"""Drivers: one plain class a device, with its protocol; entry points name them."""
