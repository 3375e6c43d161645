"""One file a format; `READERS` lists them, in the order in which they are asked."""

from __future__ import annotations

from realsim.registry import Registry

READERS = Registry(
    "log reader",
    {
        "mcap": "realsim.logs.readers.mcap:READER",
        "rosbag": "realsim.logs.readers.rosbag:READER",
        "lerobot": "realsim.logs.readers.lerobot:READER",
        "parquet": "realsim.logs.readers.parquet:READER",
        "ulog": "realsim.logs.readers.ulog:READER",
        "rerun": "realsim.logs.readers.rerun:READER",
        "json": "realsim.logs.readers.jsonfile:READER",
        "npz": "realsim.logs.readers.npz:READER",
        "torch": "realsim.logs.readers.torchfile:READER",
        "csv": "realsim.logs.readers.csvfile:READER",
    },
)
