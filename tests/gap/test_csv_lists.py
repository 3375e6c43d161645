"""Cells that hold lists, as pandas and ROS exporters write them."""

from pathlib import Path

import numpy as np
import pytest

from realsim.core.errors import GapError
from realsim.gap.case.csv_runs import read_csv

NAMES = {"time": ("time",), "command": ("a", "b"), "joint_pos": ("hip", "knee")}
MAP = {"time": "t", "command": "want", "joint_pos": {"columns": ["q[1]", "q[0]"], "unit": "deg"}}


def written(folder: Path, *rows: str) -> Path:
    path = folder / "run.csv"
    path.write_text("\n".join(["t,want,q,note", *rows]))
    return path


def test_a_list_in_a_cell_is_a_column_an_item(tmp_path: Path) -> None:
    path = written(
        tmp_path, '0.0,"[0.1, 0.2]","(90.0 45.0)",start', '0.1,,"(0 -45)",', '0.2,"[0.3,0.4]","( 9.0  18 )",x'
    )
    found = read_csv(path, MAP, NAMES, "position", [])
    np.testing.assert_allclose(found["command"], [[0.1, 0.2], [np.nan, np.nan], [0.3, 0.4]])
    np.testing.assert_allclose(np.degrees(found["joint_pos"]), [[45, 90], [-45, 0], [18, 9]])


def test_lists_of_another_length_are_refused(tmp_path: Path) -> None:
    path = written(tmp_path, '0.0,"[0.1, 0.2]","[1, 2]",', '0.1,"[0.1]","[1, 2]",')
    with pytest.raises(GapError, match="different lengths"):
        read_csv(path, MAP, NAMES, "position", [])


def test_a_list_of_too_many_joints_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, '0.0,"[0.1, 0.2, 0.3]","[1, 2]",', '0.1,"[0.1, 0, 0]","[1, 2]",')
    with pytest.raises(GapError, match="wrong number of columns"):
        read_csv(path, MAP, NAMES, "position", [])
