"""Catalogues of the texts of this package, one a language; `hilcell.language` reads them."""
