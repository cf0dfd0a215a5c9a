"""The core: equations written once, everything else derived from them."""
