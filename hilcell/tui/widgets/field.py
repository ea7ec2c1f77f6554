"""A text box whose keys act in the order typed, however fast they come.

The trap: Textual inserts letters where they arrive, but lets every other key of the box travel up
to the application first; a scanner of barcodes types its next letters before that.
"""

from __future__ import annotations

from textual.binding import BindingsMap
from textual.events import Key
from textual.widgets import Input

_KEYS = BindingsMap(Input.BINDINGS).key_to_bindings


class Field(Input):
    """An input that acts on its own keys at once."""

    async def on_key(self, event: Key) -> None:
        """Edit, or submit, before the next letter is taken."""
        for binding in _KEYS.get(event.key, ()):
            event.stop()
            event.prevent_default()
            await self.run_action(binding.action)
