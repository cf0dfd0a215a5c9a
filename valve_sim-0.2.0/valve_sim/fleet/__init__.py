"""Many bags at once: find them, examine every valve in them on Dask, and keep a table, reports and a page of it.

Needs the extra `fleet`. Nothing but the command line imports this room.
"""
