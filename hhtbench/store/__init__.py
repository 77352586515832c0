"""Results of campaigns in one SQLite file: one writer, every row with its hash."""

from hhtbench.store.rows import RunRow
from hhtbench.store.sqlite import Entry, Store, load_rows, sound_rows

__all__ = ["Entry", "RunRow", "Store", "load_rows", "sound_rows"]
