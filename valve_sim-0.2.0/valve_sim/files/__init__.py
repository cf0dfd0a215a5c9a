"""Files of other formats than bags: parameter files, tables, maps of recordings; written whole or not at all."""
