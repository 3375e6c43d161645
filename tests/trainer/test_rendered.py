"""A course that is rendered is the course: the same surfaces at the same places."""

from dataclasses import replace

import numpy as np
import pytest

from realsim.synth.terrain import top_centroid
from trainer.errors import TrainerError
from trainer.terrain import TESTS, Terrain, flat, named
from trainer.terrain.rendered import in_room


@pytest.mark.parametrize("name", TESTS)
def test_solids_in_the_room_are_the_boxes_of_the_course(name: str) -> None:
    terrain = named(name)
    room = in_room(terrain, seed=3)
    solids = room.of("start", "goal", "obstacle")
    assert room.floor_z == pytest.approx(terrain.floor_z)
    assert len(solids) == len(terrain.boxes)
    for solid, role in ((room.of("start")[0], terrain.start), (room.of("goal")[0], terrain.goal)):
        np.testing.assert_allclose(top_centroid(solid), role.centre, atol=1e-9)
    lowest = min(s.vertices.min(0)[0] for s in solids), min(s.vertices.min(0)[1] for s in solids)
    np.testing.assert_allclose(lowest, terrain.vertices[:, :2].min(0), atol=1e-9)
    for solid in solids:  # closed, seen from outside
        centre = solid.vertices.mean(0)
        faces = solid.vertices[solid.triangles]
        assert (np.einsum("ij,ij->i", solid.normals(), faces.mean(1) - centre) > 0).all()


def test_materials_are_drawn_from_the_seed() -> None:
    def materials(seed: int) -> list[str]:
        return [s.material for s in in_room(named("stake1"), seed).solids]

    assert materials(1) == materials(1)
    assert materials(1) != materials(2)


def test_only_generated_courses_can_be_rendered() -> None:
    scene: Terrain = replace(named("boxes"), contact=object())
    for terrain in (scene, flat()):
        with pytest.raises(TrainerError, match="generated"):
            in_room(terrain)
