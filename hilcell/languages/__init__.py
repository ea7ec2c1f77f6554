"""The core's texts in other languages: `hilcell.language` reads the catalogues."""
