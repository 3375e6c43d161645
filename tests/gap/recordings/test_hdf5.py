"""HDF5 and MATLAB files: what robot learning and laboratories write, and what leads out of the file."""

from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from realsim.core.errors import RealsimError
from realsim.gap.recordings.readers import hdf5, matlab
from realsim.gap.recordings.recording import Recording

h5py = pytest.importorskip("h5py", reason="h5py is not installed: pip install -e '.[logs]'")

TIME = np.arange(60) / 50
POSITION = np.stack([np.sin(TIME), np.cos(2 * TIME)], axis=1)
COMMAND = POSITION + 0.1


def columns(recording: Recording) -> dict[str, np.ndarray]:
    (stream,) = recording.streams
    return {n: f.values for n, f in stream.fields.items()}


def check(recording: Recording, position: str, command: str, clock: str) -> None:
    found = columns(recording)
    np.testing.assert_array_equal(found[position], POSITION)
    np.testing.assert_array_equal(found[command], COMMAND)
    np.testing.assert_array_equal(recording.streams[0].clocks[clock], TIME)


def test_groups_are_parts_of_names_and_images_are_left(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "episode.hdf5", "w") as file:
        file["action"], file["time"] = COMMAND, TIME
        file["observations/qpos"] = POSITION
        file["observations/images/top"] = np.zeros((60, 4, 4, 3), np.uint8)
        file["calibration"] = np.ones(7)
        file["again"] = file["/"]  # a link to a group above is not followed
    (recording,) = hdf5.read(tmp_path / "episode.hdf5")
    check(recording, "observations.qpos", "action", "time")
    assert set(columns(recording)) == {"observations.qpos", "action"}


def test_numbered_groups_are_runs_in_their_order(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "demos.hdf5", "w") as file:
        for k in range(11):
            file[f"data/demo_{k}/actions"] = COMMAND[: 30 + k]
            file[f"data/demo_{k}/obs/joint_pos"] = POSITION[: 30 + k]
    found = hdf5.read(tmp_path / "demos.hdf5")
    assert [len(columns(r)["actions"]) for r in found] == [30 + k for k in range(11)]
    assert [r.name for r in found][::10] == ["demos_demo_0", "demos_demo_10"]


def test_two_arms_of_one_run_are_no_runs(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "arms.h5", "w") as file:
        for side in ("left", "right"):
            file[f"{side}/q"], file[f"{side}/cmd"] = POSITION, COMMAND
    (recording,) = hdf5.read(tmp_path / "arms.h5")
    assert set(columns(recording)) == {"left.q", "left.cmd", "right.q", "right.cmd"}


def test_a_table_of_named_columns(tmp_path: Path) -> None:
    rows = np.zeros(60, [("stamp", "f8"), ("position", "f8", 2), ("command", "f8", 2), ("note", "S4")])
    rows["stamp"], rows["position"], rows["command"] = TIME, POSITION, COMMAND
    with h5py.File(tmp_path / "table.h5", "w") as file:
        file["log"] = rows
    (recording,) = hdf5.read(tmp_path / "table.h5")
    check(recording, "position", "command", "stamp")


@pytest.mark.parametrize("packed", [False, True])
def test_a_structure_of_matlab_with_samples_in_columns(packed: bool, tmp_path: Path) -> None:
    savemat(tmp_path / "log.mat", {"data": {"t": TIME, "q": POSITION.T, "u": COMMAND.T}}, do_compression=packed)
    (recording,) = matlab.read(tmp_path / "log.mat")
    check(recording, "q", "u", "t")


def test_matlab_since_7_3_is_hdf5(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "log.mat", "w", userblock_size=512) as file:
        for name, values in {"t": TIME[:, None], "q": POSITION, "u": COMMAND}.items():
            file[name] = values.T
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    (recording,) = matlab.read(tmp_path / "log.mat")
    check(recording, "q", "u", "t")


@pytest.mark.parametrize("how", ["link", "values", "virtual"])
def test_what_lies_in_other_files_is_refused(how: str, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["action"] = COMMAND
        if how == "link":
            file["q"] = h5py.ExternalLink("other.h5", "/q")
        elif how == "values":
            file.create_dataset("q", (60, 2), "f8", external=[("other.bin", 0, 960)])
        else:
            layout = h5py.VirtualLayout((60, 2), "f8")
            layout[:] = h5py.VirtualSource("other.h5", "q", (60, 2))
            file.create_virtual_dataset("q", layout)
    with pytest.raises(RealsimError, match="refers to another file"):
        hdf5.read(tmp_path / "log.h5")


def test_more_than_may_be_read_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "zeros.h5", "w") as file:
        file.create_dataset("q", (10**9, 100), "f8", compression="gzip", chunks=(10**4, 100))
    with pytest.raises(RealsimError, match="too large"):
        hdf5.read(tmp_path / "zeros.h5")


@pytest.mark.parametrize(("name", "reader"), [("log.h5", hdf5), ("log.mat", matlab)])
def test_what_is_no_such_file_is_refused(name: str, reader: object, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(b"MATLAB 5.0 MAT-file" + bytes(200))
    with pytest.raises(RealsimError):
        reader.read(tmp_path / name)


def test_clocks_of_signals_and_names_of_joints_beside_them(tmp_path: Path) -> None:
    """As YARP's logger writes for MATLAB: a clock a signal, nearly the same, a side of length 1, cells of names."""
    for late in (1e-4, 0.3):
        with h5py.File(tmp_path / "log.mat", "w") as file:
            for k, (name, values) in enumerate({"measured": POSITION, "desired": COMMAND}.items()):
                file[f"device/positions/{name}/data"] = values[:, None, :]
                file[f"device/positions/{name}/timestamps"] = (TIME + late * k)[:, None]
            names = [file.create_dataset(f"#refs#/{k}", data=np.array([[ord(c)] for c in n], np.uint16))
                     for k, n in enumerate(("hip", "knee"))]  # fmt: skip
            file["device/names"] = np.array([[n.ref for n in names]], dtype=h5py.ref_dtype)
            file.attrs["control_freq"] = 50.0
        (recording,) = hdf5.read(tmp_path / "log.mat")
        (stream,) = recording.streams
        assert stream.fields["measured.data"].labels == ("hip", "knee")
        assert recording.facts["control_freq"] == 50
        assert len(stream.clocks) == (1 if late < 0.01 else 0)
