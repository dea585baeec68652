"""Pictures of a `Flight`: the paper's figures (`figures`) and an animation (`animation`). Needs the `render` extra."""
