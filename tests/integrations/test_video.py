"""Films by the wrappers of Gymnasium and PettingZoo that record one (left out where moviepy is not installed)."""

import warnings

import gymnasium
import numpy as np
import pytest

import fovconn_env
from tests.integrations import SHORT

pytest.importorskip("moviepy")
imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")

from pettingzoo.utils.wrappers import RecordVideo, RecordVideoParallel

NAME = "LeaderFollow-v0"


def frames(file):
    """The pictures of a film, (T, height, width, 3), and how many a second it shows."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # the reader's, about its own process
        reader = imageio_ffmpeg.read_frames(str(file), pix_fmt="rgb24")
        about = next(reader)
        width, height = about["size"]
        shown = [np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in reader]
        reader.close()
    return np.array(shown), about["fps"]


def check(file, first):
    """It holds an episode of eight steps in real time, from its first picture on, but for the codec's small changes."""
    found, fps = frames(file)
    assert fps == 20
    assert len(found) in (9, 10)  # the start and a picture a step; moviepy may show the last one twice
    assert found.shape[1:] == first.shape
    assert np.abs(found[0].astype(int) - first).mean() < 4
    assert np.abs(found[0].astype(int) - found[-1]).max() > 60


def test_gymnasium_records(tmp_path):
    env = gymnasium.make(f"fovconn/{NAME}", render_mode="rgb_array", **SHORT)
    env = gymnasium.wrappers.RecordVideo(env, str(tmp_path / "films"), episode_trigger=lambda episode: True)
    env.reset(seed=3)
    first, over = env.unwrapped.render(), False
    while not over:
        *_, terminated, truncated, _ = env.step(np.full(env.action_space.shape, 0.5, env.action_space.dtype))
        over = terminated or truncated
    env.close()
    assert [file.name for file in (tmp_path / "films").iterdir()] == ["rl-video-episode-0.mp4"]
    check(tmp_path / "films" / "rl-video-episode-0.mp4", first)


def test_pettingzoo_records_a_parallel_environment(tmp_path):
    env = RecordVideoParallel(fovconn_env.parallel_env(NAME, render_mode="rgb_array", **SHORT), str(tmp_path / "films"))
    env.reset(seed=3)
    first = env.unwrapped.render()
    while env.agents:
        env.step({agent: np.full(4, 0.5, np.float32) for agent in env.agents})
    env.close()
    assert [file.name for file in (tmp_path / "films").iterdir()] == ["rl-video-episode-0.mp4"]
    check(tmp_path / "films" / "rl-video-episode-0.mp4", first)


def test_pettingzoo_records_an_aec_environment(tmp_path):
    """It renders after each robot's turn, six pictures a step."""
    env = RecordVideo(fovconn_env.env(NAME, render_mode="rgb_array", **SHORT), str(tmp_path / "films"))
    env.reset(seed=3)
    first = env.unwrapped.render()
    for _ in env.agent_iter():
        *_, terminated, truncated, _ = env.last()
        env.step(None if terminated or truncated else np.full(4, 0.5, np.float32))
    env.close()
    (file,) = (tmp_path / "films").iterdir()
    found, _ = frames(file)
    assert len(found) >= 8 * 6
    assert np.abs(found[0].astype(int) - first).mean() < 4
