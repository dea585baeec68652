"""The hash of a world's state, by which a flight that is computed again is compared with the recorded one.

It covers a frozen list of fields for each format, so that a field that is added or renamed later changes no hash.
Format 1 is that of version 0.1.0, which hashed the bytes of its records: what lies between two fields, and fields that
are no more, are 0. Format 2 is the fields alone, one after the other. Format 3 has those of cameras that are not ideal.
"""

from __future__ import annotations

import functools
import hashlib

import numpy as np

from fovconn_env.errors import rule
from fovconn_env.kernel.records import State
from fovconn_env.sim.simulator import Simulator

FORMATS = (1, 2, 3)
NEWEST = FORMATS[-1]
# Arrays of the state and fields of their records, under today's names, each group behind its type. Frozen.
_ARRAYS = {
    "body": "f8 x y z yaw cos_yaw sin_yaw turn_cos turn_sin vx vy vz yaw_rate roll pitch axis_x axis_y axis_z "
    "command_vx command_vy command_vz command_yaw_rate nearest clearance b1 alive sees talks",
    "flight": "f8 qw qx qy qz vx vy vz wx wy wz rotor0 rotor1 rotor2 rotor3 ex ey ez rx ry rz ax ay az yaw_reference "
    "fx fy fz",
    "pair": "f8 distance cosine b1 blocked broken seen linked i8 idle_ticks f8 weight f_star",
    "ego": "f8 vx vy vz yaw_rate roll pitch turn_cos turn_sin shift_x shift_y axis_x axis_y axis_z",
    "sight": "b1 seen f8 x y z",
    "broadcast": "f8 vx vy vz yaw_rate roll pitch x y1 y2 y3 q1 q2 q3 degree",
    "unicast": "b1 sent arrives seen yaw_valid f8 px py pz gamma f cos_yaw sin_yaw",
    "inbox": "b1 fresh news seen yaw_valid f8 age x y1 y2 y3 q1 q2 q3 degree vx vy vz yaw_rate roll pitch px py pz "
    "gamma f cos_yaw sin_yaw",
    "track": "b1 present held tracking valid f8 x y z distance f gamma weight unseen since lapse lx ly ex ey qx qy "
    "cos_yaw sin_yaw cos_used sin_used",
    "belief": "f8 x y1 y2 y3 q1 q2 q3 degree lambda2_hat v2_hat",
    "beat": "i8",
    "beat_air": "i8",
    "table": "f8",
    "air": "f8",
    "mode": "f8",
    "episode": "u8 key i8 n_rounds step max_steps leader f8 stick_x stick_y stick_z i8 waypoint f8 wait held split "
    "lambda2 i8 n_edges f8 pushed travelled b1 over terminated truncated success collision disconnected rests",
    "fiedler": "f8",
    "info": "f8 lambda2 lambda2_hat connected n_edges min_distance clearance yaw_error success collision disconnected "
    "lost_link_cause bytes_sent neighbors_dropped alive reward_connectivity reward_progress reward_proximity "
    "reward_effort reward_success reward_collision reward_disconnected",
    "reward": "f8",
    "flat": "f4",
}
# What format 3 has beyond the others: more fields of an array, or more arrays behind them. Frozen.
_ADDED = {
    "info": "f8 name_swaps",
    "report": "b1 seen f8 x y z",
    "missing": "b1",
    "motion": "f8 turn_cos turn_sin shift_x shift_y rise",
    "blob": "b1 used matched wrong i8 name code f8 x y z age unseen read",
}
_GONE = {"track": ("qx", "qy")}  # v_j filtered like e, of an option that was taken out
_TYPES = ("f8", "f4", "i8", "u8", "b1")


def state_hash(simulator: Simulator, world: int = 0, *, format: int = NEWEST) -> str:
    """Hash of a world's state now; format: one of FORMATS, other ones are a `SettingError`."""
    return hash_state(simulator.state, world, format=format)


def hash_state(state: State, world: int, *, format: int = NEWEST) -> str:
    """As `state_hash`, of a state that is no simulator's."""
    rule(format in FORMATS, "format", f"one of {', '.join(map(str, FORMATS))}", format, "is it of a newer fovconn_env?")
    digest = hashlib.sha256()
    for name, dtype in frozen_dtypes(format).items():
        array = getattr(state, name)[world : world + 1]
        if dtype.names is None:
            digest.update(np.ascontiguousarray(array, dtype).data)
            continue
        fields = [field for field in dtype.names if field not in _GONE.get(name, ())]
        record = np.zeros(array.shape, dtype)
        record[fields] = array[fields]
        digest.update(record.data)
    return digest.hexdigest()


@functools.cache
def frozen_dtypes(format: int) -> dict[str, np.dtype]:
    """The types of a format's arrays, in the order in which they are hashed."""
    dtypes, arrays = {}, dict(_ARRAYS)
    if format >= 3:
        for name, text in _ADDED.items():
            arrays[name] = f"{arrays.get(name, '')} {text}"
    for name, text in arrays.items():
        fields, kind = [], ""
        for word in text.split():
            if word in _TYPES:
                kind = word
            elif format == 1 or word not in _GONE.get(name, ()):
                fields.append((word, kind))
        dtypes[name] = np.dtype(fields, align=format == 1) if fields else np.dtype(kind)
    return dtypes
