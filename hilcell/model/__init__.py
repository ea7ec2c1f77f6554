"""Types of a run's data, as stored in its journal; every other package reads them."""
