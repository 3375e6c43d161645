"""One file a capture layout; `realsim.capture.LAYOUTS` lists them."""
