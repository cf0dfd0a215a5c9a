"""Tests of fleets; without the extra `fleet` they are skipped, and say what is missing."""

import pytest

for package in ("dask", "distributed", "fsspec", "pyarrow", "s3fs"):
    pytest.importorskip(package, reason=f"needs {package}: pip install '.[fleet]'")
