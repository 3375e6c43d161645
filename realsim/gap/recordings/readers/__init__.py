"""One file a format; `READERS` lists them, in the order in which they are asked."""

from realsim.core.registry import Registry

READERS = Registry(
    "log reader",
    {
        "mcap": "realsim.gap.recordings.readers.bags:MCAP",
        "rosbag": "realsim.gap.recordings.readers.bags:ROSBAG",
        "lerobot": "realsim.gap.recordings.readers.lerobot:READER",
        "parquet": "realsim.gap.recordings.readers.parquet:READER",
        "ulog": "realsim.gap.recordings.readers.ulog:READER",
        "rerun": "realsim.gap.recordings.readers.rerun:READER",
        "crazyflie": "realsim.gap.recordings.readers.crazyflie:READER",
        "json": "realsim.gap.recordings.readers.jsonfile:READER",
        "npz": "realsim.gap.recordings.readers.npz:READER",
        "hdf5": "realsim.gap.recordings.readers.hdf5:READER",
        "matlab": "realsim.gap.recordings.readers.matlab:READER",
        "torch": "realsim.gap.recordings.readers.torchfile:READER",
        "plotter": "realsim.gap.recordings.readers.plotter:READER",
        "influx": "realsim.gap.recordings.readers.influx:READER",
        "csv": "realsim.gap.recordings.readers.csvfile:READER",
    },
)
