"""Noise from a counter: the same (key, counter, index, purpose) gives the same number, whatever else is drawn.

A result then depends neither on the batch nor on threads, and one source of noise never shifts another.
"""

from __future__ import annotations

import math

import numpy as np

from fovconn_env.kernel.jit import kernel

# purposes
MISS, LOSS, START, FORCE, ROTOR, ACQUIRE, STICK, FRAME, FALSE = range(9)
POSITION, VELOCITY, GYRO, ATTITUDE, RANGE, BEARING = range(16, 22)
BIAS = 32  # added to a purpose: drawn once an episode

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX2 = np.uint64(0x94D049BB133111EB)
_S27, _S30, _S31, _S11, _S32, _S8 = (np.uint64(n) for n in (27, 30, 31, 11, 32, 8))


@kernel
def scramble(z):
    """Finaliser of SplitMix64 (Steele, Lea and Flood, OOPSLA 2014). uint64 in and out."""
    z = (z ^ (z >> _S30)) * _MIX1
    z = (z ^ (z >> _S27)) * _MIX2
    return z ^ (z >> _S31)


@kernel
def draw(key, counter, index, purpose):
    """64 random bits. key (uint64); counter (tick or round), index (robot or pair) and purpose, integers."""
    place = (np.uint64(counter) << _S32) ^ (np.uint64(index) << _S8) ^ np.uint64(purpose)
    return scramble(scramble(key + _GOLDEN) ^ (place * _GOLDEN + _GOLDEN))


@kernel
def uniform(bits):
    """A number in (0, 1) from 64 bits."""
    return (float(bits >> _S11) + 0.5) * (1.0 / 9007199254740992.0)


@kernel
def normal_pair(bits):
    """Two independent standard normal numbers from 64 bits (Box and Muller 1958)."""
    radius = math.sqrt(-2.0 * math.log(uniform(bits)))
    angle = 2.0 * math.pi * uniform(scramble(bits + _GOLDEN))
    return radius * math.cos(angle), radius * math.sin(angle)


@kernel
def normal_triple(key, counter, index, purpose):
    """Three independent standard normal numbers."""
    bits = draw(key, counter, index, purpose)
    a, b = normal_pair(bits)
    c, _ = normal_pair(scramble(bits ^ _MIX1))
    return a, b, c


@kernel
def sensor_error(key, counter, index, purpose, noise, bias):
    """Three errors of a sensor, standard deviations `noise` (drawn at every counter) and `bias` (once an episode)."""
    a, b, c = normal_triple(key, counter, index, purpose)
    d, e, f = normal_triple(key, 0, index, purpose + BIAS)
    return noise * a + bias * d, noise * b + bias * e, noise * c + bias * f
