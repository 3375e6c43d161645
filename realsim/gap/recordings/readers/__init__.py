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
        "npz": "realsim.gap.recordings.readers.npz:READER",
        "hdf5": "realsim.gap.recordings.readers.hdf5:READER",
        "matlab": "realsim.gap.recordings.readers.matlab:READER",
        "torch": "realsim.gap.recordings.readers.torchfile:READER",
        "records": "realsim.gap.recordings.readers.records:READER",
        "csv": "realsim.gap.recordings.readers.csvfile:READER",
    },
)
