"""Results of campaigns in one SQLite file: one writer, every row with its hash."""

from hhtbench.campaign.store.reading import Reading
from hhtbench.campaign.store.rows import RunRow
from hhtbench.campaign.store.sqlite import Entry, Store, load_rows, read_store, sound_rows

__all__ = ["Entry", "Reading", "RunRow", "Store", "load_rows", "read_store", "sound_rows"]
