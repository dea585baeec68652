"""The `fovconn` command; what it needs beside the environments comes with extras, and is named where it is missing."""

from __future__ import annotations

import sys

from fovconn_env.errors import missing_package


def main() -> None:
    """Run the command."""
    try:
        from fovconn_env.training.commands import app
    except ModuleNotFoundError as problem:
        missing = missing_package("fovconn", problem)
        if missing is None:
            raise
        print(f"fovconn: {missing}", file=sys.stderr)
        sys.exit(2)
    app.main()


if __name__ == "__main__":
    main()
