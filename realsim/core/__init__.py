"""What every part of realsim may use: types, errors, files, geometry, progress, statistics. It imports no stage."""
