"""Flights: records of an episode, recordings that replay bit for bit, metrics."""

from fovconn_env.flights.flight import Film, Flight, fly, from_recording
from fovconn_env.flights.metrics import Meter
from fovconn_env.flights.recorder import Recorder
from fovconn_env.flights.recording import Recording, load, replay

__all__ = [
    "Film",
    "Flight",
    "Meter",
    "Recorder",
    "Recording",
    "fly",
    "from_recording",
    "load",
    "replay",
]
