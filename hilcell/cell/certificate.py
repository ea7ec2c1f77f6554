"""The parties of a certificate, laboratory and customer: a run cannot know them."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from hilcell.cell.tables import Frozen

Country = Annotated[str, Meta(pattern="^([A-Z]{2})?$")]


class CertificateTable(Frozen, frozen=True, kw_only=True):
    """Laboratory and customer as the first page and the DCC name them; "" is a line to fill in.

    ``country`` is the laboratory's, two letters (ISO 3166-1).
    """

    laboratory: str = ""
    laboratory_address: str = ""
    laboratory_email: str = ""
    country: Country = ""
    customer: str = ""
    customer_address: str = ""
    customer_email: str = ""
