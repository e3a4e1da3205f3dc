"""Tracks after a frame in; who is confirmed, who left and who came back out.

Somebody is confirmed, and gets a label, after several frames; one of low confidence has to be seen for longer, for
false people are unsure and short. One who is not seen for the time-out leaves and is remembered by height and place.
One who is confirmed takes the label of one who left, or of one not seen for a moment, if he can be the same.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool

from .identities import returned
from .people_settings import Settings
from .people_tracks import Remembered, Tracks, chosen, places

LIKELY, LONGER = 0.42, 6  # mean confidence at which one is confirmed at once; otherwise it takes so many times longer
UNTOLD = 4  # times as long, if too little of somebody is seen to tell his height
ANYBODY = 3  # times as long, if it can be somebody who left: his height has to be told well
PATIENCE = 0.15  # seconds for which one who is not confirmed may be unseen
AWAY = 0.3  # seconds unseen after which a known person may be found again elsewhere


@dataclass(frozen=True, slots=True, eq=False)
class PeopleState:
    """What is known after a frame: who is followed, who is remembered, the next label, the time (s, NaN: none yet)."""

    settings: Settings
    tracks: Tracks
    remembered: Remembered
    next_label: int
    time: float


def living(state: PeopleState, dt: float) -> PeopleState:
    """Confirm, let go, remember and recognise people after a frame."""
    settings, tracks = state.settings, state.tracks
    new = (tracks.label < 0) & (tracks.hits >= settings.confirm)
    patience = settings.confirm * (ANYBODY if state.remembered.label.size else 1)
    new &= (tracks.told >= patience) | (tracks.hits >= UNTOLD * patience)
    if new.any():
        mean = tracks.sure / np.maximum(tracks.hits, 1)
        new &= (mean >= LIKELY) | (tracks.hits >= LONGER * settings.confirm)
        for i in np.flatnonzero(new).tolist():
            state = _confirmed(state, i)
        tracks = state.tracks
    known = tracks.label >= 0
    gone = known & (tracks.unseen > settings.time_out)
    dropped = (tracks.label == REPLACED) | (~known & (tracks.unseen > PATIENCE))
    remembered = state.remembered
    if gone.any():
        remembered = _with(remembered, tracks, gone, state.time)
    if remembered.label.size:
        remembered = _some(remembered, state.time - remembered.time <= settings.remember)
    return replace(state, tracks=chosen(tracks, ~(gone | dropped)), remembered=remembered)


REPLACED = -2  # label of a track whose person was found again elsewhere


def _confirmed(state: PeopleState, i: int) -> PeopleState:
    """Give track i its label: that of one who came back, or a new one."""
    tracks, old = state.tracks, state.remembered
    place = places(tracks.p)
    away = np.flatnonzero((tracks.label >= 0) & (tracks.unseen > AWAY))
    found = returned(
        float(tracks.height[i]),
        place[i],
        np.concatenate([old.height, tracks.height[away]]),
        np.concatenate([old.place, place[away]]),
        np.concatenate([state.time - old.time, tracks.unseen[away]]),
    )
    label = tracks.label.copy()
    if found < 0:
        label[i] = state.next_label
        return replace(state, tracks=replace(tracks, label=label), next_label=state.next_label + 1)
    if found < old.label.size:
        label[i] = old.label[found]
        kept = np.arange(old.label.size) != found
        return replace(state, tracks=replace(tracks, label=label), remembered=_some(old, kept))
    other = away[found - old.label.size]
    label[i], label[other] = label[other], REPLACED
    return replace(state, tracks=replace(tracks, label=label))


def _with(old: Remembered, tracks: Tracks, gone: Bool[np.ndarray, " q"], time: float) -> Remembered:
    return Remembered(
        np.concatenate([old.label, tracks.label[gone]]),
        np.concatenate([old.height, tracks.height[gone]]),
        np.concatenate([old.place, places(tracks.p[gone])]),
        np.concatenate([old.time, time - tracks.unseen[gone]]),
    )


def _some(old: Remembered, kept: Bool[np.ndarray, " r"]) -> Remembered:
    return Remembered(old.label[kept], old.height[kept], old.place[kept], old.time[kept])
