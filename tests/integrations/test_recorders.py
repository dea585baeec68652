"""The recorders of Gymnasium and PettingZoo write films of our pictures (both need moviepy)."""

import re
import warnings

import gymnasium
import numpy as np
import pytest

import fovconn_env
from tests.integrations import EXAMPLES, SHORT

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # moviepy 1 has escapes that Python warns of when it compiles them
    pytest.importorskip("moviepy.video.io.ImageSequenceClip", reason="moviepy is not installed: pip install moviepy")
av = pytest.importorskip("av", reason='av is not installed: pip install "fovconn-env[export]"')
pytest.importorskip("pygame", reason='pygame is not installed: pip install "fovconn-env[render]"')
NAME = "rl-video-episode-0.mp4"
AHEAD = np.array([1.0, 0.0, 0.0, 0.0], np.float32)
BLOCKS = re.findall(r"^```py\n(.*?)^```$", (EXAMPLES.parent / "recording.md").read_text("utf-8"), re.DOTALL | re.M)


def frames(path):
    """What a film holds, (frames, height, width, 3), and its pictures a second."""
    with av.open(str(path)) as film:
        rate = film.streams.video[0].average_rate
        return np.stack([frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]).astype(int), rate


def check(path, pictures, steps_a_second=20):
    """The film shows these pictures, one a step, as far as H.264 keeps them."""
    film, rate = frames(path)
    assert rate == steps_a_second
    assert film.shape == (SHORT["max_cycles"] + 1, 480, 640, 3)
    off = np.array([[np.abs(shown - picture).mean() for picture in pictures] for shown in film])
    assert off.diagonal().max() < 5.0  # of 255
    np.testing.assert_array_equal(off.argmin(axis=1), np.arange(len(film)))


def test_gymnasium_record_video(tmp_path):
    env = gymnasium.make("fovconn/LeaderFollow-v0", render_mode="rgb_array", **SHORT)
    env = gymnasium.wrappers.RecordVideo(env, str(tmp_path / "films"), episode_trigger=lambda episode: episode == 0)
    env.reset(seed=7)
    pictures, over = [env.render()], False
    while not over:
        *_, terminated, truncated, _ = env.step(np.tile(AHEAD, (6, 1)))
        pictures.append(env.render())
        over = terminated or truncated
    env.reset()  # not recorded
    env.close()
    assert [file.name for file in (tmp_path / "films").iterdir()] == [NAME]
    check(tmp_path / "films" / NAME, pictures)


def test_pettingzoo_record_video(tmp_path):
    env = fovconn_env.parallel_env("LeaderFollow-v0", render_mode="rgb_array", **SHORT)
    env = pytest.importorskip("pettingzoo.utils.wrappers").RecordVideoParallel(env, str(tmp_path / "films"))
    env.reset(seed=7)
    pictures = [env.render()]
    while env.agents:
        env.step(dict.fromkeys(env.agents, AHEAD))
        pictures.append(env.render())
    env.close()
    check(tmp_path / "films" / NAME, pictures)


@pytest.mark.parametrize("kind", ["gymnasium", "pettingzoo"])
def test_a_film_of_a_slow_clock_lasts_as_long_as_the_flight(kind, tmp_path):
    given = {"render_mode": "rgb_array", "clock": fovconn_env.Clock(ticks=10), **SHORT}
    if kind == "gymnasium":
        env = gymnasium.make("fovconn/LeaderFollow-v0", **given)
        env = gymnasium.wrappers.RecordVideo(env, str(tmp_path / "films"), episode_trigger=lambda episode: episode == 0)
    else:
        env = pytest.importorskip("pettingzoo.utils.wrappers").RecordVideoParallel(
            fovconn_env.parallel_env(**given), str(tmp_path / "films")
        )
    env.reset(seed=7)
    pictures = [env.render()]
    for _ in range(SHORT["max_cycles"]):
        env.step(np.tile(AHEAD, (6, 1)) if kind == "gymnasium" else dict.fromkeys(env.agents, AHEAD))
        pictures.append(env.render())
    env.close()
    check(tmp_path / "films" / NAME, pictures, 10)


@pytest.mark.filterwarnings("ignore:.*Vector environment's autoreset mode")
def test_gymnasium_record_video_of_a_batch(tmp_path):
    recorder = pytest.importorskip("gymnasium.wrappers.vector").RecordVideo
    env = gymnasium.make_vec("fovconn/LeaderFollow-v0", num_envs=2, render_mode="rgb_array", **SHORT)
    env = recorder(env, str(tmp_path / "films"), episode_trigger=lambda episode: episode == 0)
    env.reset(seed=7)
    for _ in range(SHORT["max_cycles"] + 2):
        env.step(np.tile(AHEAD, (2, 6, 1)))
    env.close()
    film, rate = frames(next((tmp_path / "films").glob("*.mp4")))
    assert rate == 20
    assert len(film) >= SHORT["max_cycles"]
    assert film[0].shape[0] * film[0].shape[1] >= 2 * 480 * 640


def test_stable_baselines_records_rows(tmp_path):
    recorder = pytest.importorskip("stable_baselines3.common.vec_env").VecVideoRecorder
    from fovconn_env.training.sb3 import make_vec_env

    given = {"render_mode": "rgb_array", "clock": fovconn_env.Clock(ticks=10), **SHORT, "max_cycles": 50}
    env = make_vec_env(n_worlds=2, seed=7, **given)
    env = recorder(env, str(tmp_path), lambda step: step == 0, video_length=6)
    env.reset()
    pictures = [env.render()]
    for _ in range(6):
        env.step(np.tile(AHEAD, (12, 1)))
        pictures.append(env.render())
    env.close()
    film, rate = frames(tmp_path / "rl-video-step-0-to-step-6.mp4")
    assert rate == 10
    assert film.shape == (7, 960, 640, 3)
    off = np.array([[np.abs(shown - picture).mean() for picture in pictures] for shown in film])
    np.testing.assert_array_equal(off.argmin(axis=1), np.arange(7))


@pytest.mark.parametrize("block", BLOCKS, ids=["gymnasium", "pettingzoo"])
def test_the_examples_write_a_film(block, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(compile(block, "recording.md", "exec"), names)
    names["env"].reset(seed=7)
    names["env"].close()
    film, _ = frames(tmp_path / "films" / NAME)
    assert film.shape == (1, 480, 640, 3)


def test_pettingzoo_record_video_of_an_aec_environment(tmp_path):
    """A picture after the reset and after each robot's turn; the world moves with the last one's."""
    env = fovconn_env.env("LeaderFollow-v0", render_mode="rgb_array", **SHORT)
    env = pytest.importorskip("pettingzoo.utils.wrappers").RecordVideo(env, str(tmp_path / "films"))
    env.reset(seed=7)
    pictures, turns = [env.render()], 0
    for _ in env.agent_iter():
        *_, terminated, truncated, _ = env.last()
        env.step(None if terminated or truncated else AHEAD)
        turns += not (terminated or truncated)
        pictures.append(env.render())
    env.close()
    assert turns == 6 * SHORT["max_cycles"]
    film, _ = frames(tmp_path / "films" / NAME)
    assert turns < len(film) <= len(pictures)  # the turns in which robots leave may be there, too
    off = [np.abs(film[k] - pictures[k]).mean() for k in (0, 6, turns // 2, -1)]
    assert max(off) < 5.0  # of 255
