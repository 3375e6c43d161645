"""Collision representations; they are listed in `realsim.export.CONTACT`."""
