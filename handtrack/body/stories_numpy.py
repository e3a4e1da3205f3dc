"""Plain twin of the stories' compiled step (`_kernels.people.hypotheses_step`): stories of a frame in and out.

Written for reading: one keypoint at a time, candidates as parallel arrays (x, v, c, outlier, log weight).
"""

import math

import numpy as np

_GROUP = np.array([0, 0, 1])  # which variance an axis has: across the view, or along it


def hypotheses_step_numpy(
    x, v, c, weight, out, last, z, logit, r, dt, drift, motion, parent, length, rest, slack, rules, mean, spread, right
) -> None:
    """One frame of every keypoint's stories, with the kernel's arguments; fills the same arrays."""
    ease = 1.0 - math.exp(-dt / rules[6])
    for who, k in np.ndindex(weight.shape[:2]):
        up, long, seen = parent[k], length[who, k], not np.isnan(z[who, k, 0])
        limb = not np.isnan(long) and not np.isnan(mean[who, up, 0])
        root, give = mean[who, up].copy(), slack**2 + np.trace(spread[who, up]) / 3.0
        old = weight[who, k] > 0
        story = [a[who, k][old].copy() for a in (x, v, c, out)] + [np.log(weight[who, k][old])]
        if old.any():
            moved(story, drift[who], dt, motion[k])
            if limb:
                pulled(story, root, rest[who, k], ease, long, give)
        elif limb:
            story = _begun(root + rest[who, k], drift[who], motion[k])
        right[who, k] = 0.0
        mean[who, k] = np.nan
        if not story[4].size and (not seen or logit[who, k] < rules[7]):
            continue
        if seen:
            bone = min(0.5 * (np.linalg.norm(z[who, k] - root) - long) ** 2 / give, rules[4]) if limb else 0.0
            again = _stayed(z[who, k], last[who, k], r[who, k], rules[5])
            story = parted(story, z[who, k], logit[who, k], bone, again, r[who, k], motion[k, 0], drift[who], rules)
            last[who, k] = z[who, k]
        share = np.exp(story[4] - story[4].max())
        share /= share.sum()
        if seen:
            right[who, k] = (share * (1.0 - story[3])).sum()
        kept = merged(story, share, weight.shape[2], rules[3])
        n = kept[4].size
        w = kept[4] / kept[4].sum()
        weight[who, k], weight[who, k, :n] = 0.0, w
        for array, part in zip((x, v, c, out), kept, strict=False):
            array[who, k, :n] = part
        mean[who, k] = w @ kept[0]
        off = kept[0] - mean[who, k]
        spread[who, k] = (w[:, None] * off).T @ off + np.diag(w @ kept[2][:, _GROUP, 0])


def moved(story, drift, dt, motion) -> None:
    """A frame later: speeds decay to the whole person's (Ornstein-Uhlenbeck), variances grow up to a cap."""
    speed, tau, cap, shake = motion
    decay = math.exp(-dt / tau)
    reach, power = tau * (1.0 - decay), 2.0 * speed**2 / tau
    own = story[1] - drift
    story[0] += drift * dt + own * reach
    story[1] = drift + own * decay
    pp, pv, vv = np.moveaxis(story[2], -1, 0)
    a = pp + 2 * reach * pv + reach**2 * vv + power * dt**3 / 3 + shake * dt
    b = decay * (pv + reach * vv) + power * dt**2 / 2
    b = np.where(a > cap**2, b * cap / np.sqrt(a), b)
    story[2] = np.stack([np.minimum(a, cap**2), b, decay**2 * vv + power * dt], axis=-1)


def pulled(story, root, rest, ease, long, give) -> None:
    """Towards where the joint mostly is, then towards its bone's length from the other end."""
    story[0] += ease * (root + rest - story[0])
    off = story[0] - root
    apart = np.linalg.norm(off, axis=1)
    pp = (2.0 * story[2][:, 0, 0] + story[2][:, 1, 0]) / 3.0
    pull = np.maximum(1.0 + pp / (pp + give) * (long - apart) / np.maximum(apart, 1e-6), 0.0)
    story[0] = root + pull[:, None] * off


def _begun(place, drift, motion) -> list:
    """The one story of a keypoint that was never seen."""
    c = np.tile([motion[2] ** 2, 0.0, motion[0] ** 2], (1, 2, 1))
    return [place[None].copy(), drift[None].copy(), c, np.zeros(1), np.zeros(1)]


def _stayed(z, last, r, share) -> float:
    """Logarithm of the density of an outlier that follows one at `last`."""
    if np.isnan(last[0]):
        return 0.0
    total = 2.0 * r[_GROUP]
    near = math.exp(-0.5 * ((z - last) ** 2 / total).sum()) / math.sqrt(np.prod(2.0 * np.pi * total))
    return math.log(share * near + 1.0 - share)


def parted(story, z, logit, bone, again, r, speed, drift, rules) -> list:
    """Every story in two, the measurement right or an outlier, and one more in which all before was wrong."""
    x, v, c, out, log = story
    odds = logit - bone - rules[0] * out
    yes = np.where(odds > -30.0, -np.log1p(np.exp(-np.maximum(odds, -30.0))), odds)
    off, pp, pv, vv = z - x, c[..., 0], c[..., 1], c[..., 2]
    total = pp + r
    gain, follow = (pp / total)[:, _GROUP], (pv / total)[:, _GROUP]
    like = -0.5 * (off**2 / total[:, _GROUP] + np.log(2.0 * np.pi * total[:, _GROUP])).sum(axis=1)
    told = np.stack([pp - pp * pp / total, pv - pp * pv / total, vv - pv * pv / total], axis=-1)
    fresh = np.tile(np.stack([r, 0.0 * r, 0.0 * r + speed**2], axis=-1), (1, 1, 1))
    begin = rules[2] + rules[1] - math.log1p(math.exp(bone - logit)) if log.size else 0.0
    wrong = log + (yes - odds) + np.where(out > 0.5, again, rules[1])
    parts = (
        (x, x + gain * off, z[None]), (v, v + follow * off, drift[None]), (c, told, fresh),
        (np.ones(log.size), np.zeros(log.size), np.zeros(1)), (wrong, log + yes + like, [begin]),
    )  # fmt: skip
    return [np.concatenate(part) for part in parts]


def merged(story, share, most, near) -> list:
    """The heaviest stories, alike ones as one, by falling weight of each one's first."""
    x, v, c, out, _ = story
    kept: list[list] = []
    for i in np.argsort(-share):
        if not share[i] > 1e-7:
            break
        same = next((each for each in kept if _alike(each, x[i], v[i], c[i], near)), None)
        if same is None:
            if len(kept) < most:
                kept.append([x[i].copy(), v[i].copy(), c[i].copy(), out[i], share[i]])
            continue
        total = same[4] + share[i]
        a, b = same[4] / total, share[i] / total
        dx, dv = x[i] - same[0], v[i] - same[1]
        both = np.stack([dx * dx, dx * dv, dv * dv], axis=-1)
        same[2] = a * same[2] + b * c[i] + a * b * np.stack([0.5 * (both[0] + both[1]), both[2]])
        same[0], same[1], same[3], same[4] = same[0] + b * dx, same[1] + b * dv, a * same[3] + b * out[i], total
    return [np.array([each[part] for each in kept]) for part in range(5)]


def _alike(each, x, v, c, near) -> bool:
    return bool(
        ((x - each[0]) ** 2).sum() < near**2
        and ((v - each[1]) ** 2).sum() < 100.0 * near**2
        and c[0, 0] < 3.0 * each[2][0, 0] + near**2
    )
