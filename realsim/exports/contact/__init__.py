"""Collision representations; they are listed in `realsim.exports.CONTACT`."""
