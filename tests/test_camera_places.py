"""Where a point is seen, and which point is seen there: two ways that lead back to each other, and to what is rendered."""

import numpy as np
import pytest

from preimage.robot import TASKS, Arm, Camera


@pytest.mark.parametrize("camera", [Camera(), Camera(height=48, width=80), TASKS["move-object"].workspace.camera])
@pytest.mark.parametrize("height_m", [0.0, 0.03, 0.2])
def test_a_point_that_is_seen_somewhere_is_the_one_found_there(camera, height_m):
    for place in np.random.default_rng(0).uniform((0.1, -0.3, height_m), (0.6, 0.3, height_m), (20, 3)):
        np.testing.assert_allclose(camera.place_at(camera.project(place), height_m), place, atol=1e-9)


def test_the_middle_of_the_picture_shows_the_target():
    np.testing.assert_allclose(Camera().project(np.array(Camera().target_m)), [0.5, 0.5], atol=1e-12)


def test_above_the_horizon_no_table_is_seen():
    assert Camera(target_m=(0.84, 0.0, 1.5), position_m=(0.85, 0.0, 1.5)).place_at(np.array([0.5, 0.1]), 0.0) is None


def test_a_circle_is_rendered_where_it_is_projected():
    task = TASKS["move-object"]
    scene = task.sample(np.random.default_rng(500))
    arm = Arm()
    task.lay_out(arm, scene)
    camera, circle = task.workspace.camera, np.array(scene.positions_m["circle"])
    across, down = camera.project(circle) * (camera.width, camera.height)
    frame = arm.sense().frame[..., 0]
    assert frame[int(down), int(across)] >= frame.max() - 2  # the lightest thing in sight, a little less lit than at its edge
