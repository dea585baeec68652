"""Pictures in a process of its own, without a display: what is imported, and what says that a display is missing."""

import os
import subprocess
import sys

import pytest

HIDDEN = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER", "SDL_AUDIODRIVER", "XDG_RUNTIME_DIR", "MPLBACKEND")
BARE = {name: value for name, value in os.environ.items() if name not in HIDDEN}
PROGRAMS = {
    "a live picture": """
        import fovconn_env, pygame
        env = fovconn_env.parallel_env(render_mode="rgb_array", warmup=0.1)
        env.reset(seed=0)
        assert env.render().std() > 8
        assert not pygame.display.get_init()
        """,
    "a window": """
        import fovconn_env, gymnasium
        env = fovconn_env.parallel_env(render_mode="human", warmup=0.1)
        try:
            env.reset(seed=0)
        except gymnasium.error.Error as error:
            assert "needs a display" in str(error) and "rgb_array" in str(error)
        else:
            raise AssertionError("a window without a display")
        """,
    "figures": """
        import sys, pathlib, fovconn_env.render.figures.animation
        from fovconn_env.render.figures import curves, paper, style
        picture = style.save(curves.draw_activation(), pathlib.Path("activation.png"))
        assert picture.stat().st_size > 10_000
        assert "matplotlib.pyplot" not in sys.modules
        """,
    "pages": """
        import sys, fovconn_env.render.page.rerun_log, fovconn_env.render.page.web_page
        assert not {"rerun", "pyarrow", "matplotlib", "pygame"} & set(sys.modules)
        """,
    "messages": """
        import sys, fovconn_env.fleet.ros.foxglove_server, fovconn_env.fleet.ros.mcap_file
        assert not {"mcap", "rosbags", "foxglove", "matplotlib", "pygame"} & set(sys.modules)
        """,
}


@pytest.mark.parametrize("name", PROGRAMS)
def test_without_a_display(name, tmp_path):
    program = "if True:\n" + PROGRAMS[name]
    run = subprocess.run([sys.executable, "-c", program], env=BARE, cwd=tmp_path, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
