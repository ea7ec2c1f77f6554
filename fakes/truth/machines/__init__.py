"""Machines that come with the fakes, one TOML file each."""
