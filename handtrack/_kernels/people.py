"""Compiled steps of the permanence filter: all keypoints of all people in one call."""

import math

import numpy as np
from numba import njit


@njit(cache=True)
def _merged(x, v, c, out, weight, order, most, near, kept):  # pragma: no cover - compiled
    """Put the heaviest candidates into places 0... of `kept`, alike ones as one; the number of places used."""
    kx, kv, kc, kout, kw = kept
    used = 0
    for at in range(order.size):
        i = order[at]
        if not weight[i] > 1e-7:
            break
        same = -1
        for j in range(used):
            apart, speed = 0.0, 0.0
            for d in range(3):
                apart += (x[i, d] - kx[j, d]) ** 2
                speed += (v[i, d] - kv[j, d]) ** 2
            if apart < near * near and speed < 100.0 * near * near and c[i, 0, 0] < 3.0 * kc[j, 0, 0] + near * near:
                same = j
                break
        if same < 0:
            if used == most:
                continue
            kx[used], kv[used], kc[used], kout[used], kw[used] = x[i], v[i], c[i], out[i], weight[i]
            used += 1
            continue
        total = kw[same] + weight[i]
        a, b = kw[same] / total, weight[i] / total
        for g in range(2):
            for e in range(3):
                kc[same, g, e] = a * kc[same, g, e] + b * c[i, g, e]
        for d in range(3):
            g = 1 if d == 2 else 0
            share = 1.0 if g == 1 else 0.5
            dx, dv = x[i, d] - kx[same, d], v[i, d] - kv[same, d]
            kc[same, g, 0] += share * a * b * dx * dx
            kc[same, g, 1] += share * a * b * dx * dv
            kc[same, g, 2] += share * a * b * dv * dv
            kx[same, d] += b * dx
            kv[same, d] += b * dv
        kout[same] = a * kout[same] + b * out[i]
        kw[same] = total
    return used


@njit(cache=True)
def _moved(story, at, drift, dt, motion, here):  # pragma: no cover - compiled
    """Put story `at` of a keypoint, a frame later, at place `here[5]` of the candidates."""
    x, v, c, weight, out = story
    cx, cv, cc, cout, cw, j = here
    speed, tau, cap, shake = motion[0], motion[1], motion[2], motion[3]
    decay = math.exp(-dt / tau)
    reach = tau * (1.0 - decay)
    power = 2.0 * speed * speed / tau
    for d in range(3):
        own = v[at, d] - drift[d]
        cx[j, d] = x[at, d] + drift[d] * dt + own * reach
        cv[j, d] = drift[d] + own * decay
    for g in range(2):
        pp, pv, vv = c[at, g, 0], c[at, g, 1], c[at, g, 2]
        a = pp + 2.0 * reach * pv + reach * reach * vv + power * dt**3 / 3.0 + shake * dt
        b = decay * (pv + reach * vv) + power * dt * dt / 2.0
        if a > cap * cap:
            b *= cap / math.sqrt(a)
            a = cap * cap
        cc[j, g, 0], cc[j, g, 1], cc[j, g, 2] = a, b, decay * decay * vv + power * dt
    cout[j] = out[at]
    cw[j] = math.log(weight[at])


@njit(cache=True)
def _pulled(cx, cc, j, root, rest, ease, long, give):  # pragma: no cover - compiled
    """Draw a candidate to where it mostly rests, and to the sphere of radius `long` about its bone's other end."""
    apart = 0.0
    for d in range(3):
        cx[j, d] += ease * (root[d] + rest[d] - cx[j, d])
        apart += (cx[j, d] - root[d]) ** 2
    apart = math.sqrt(apart)
    pp = (2.0 * cc[j, 0, 0] + cc[j, 1, 0]) / 3.0
    pull = max(1.0 + pp / (pp + give) * (long - apart) / max(apart, 1e-6), 0.0)
    for d in range(3):
        cx[j, d] = root[d] + pull * (cx[j, d] - root[d])


@njit(cache=True)
def _begun(root, rest, drift, motion, parts):  # pragma: no cover - compiled
    """The first candidate of a keypoint that was never seen: somewhere about where it mostly rests."""
    cx, cv, cc, cout, cw = parts
    for d in range(3):
        cx[0, d], cv[0, d] = root[d] + rest[d], drift[d]
    for g in range(2):
        cc[0, g, 0], cc[0, g, 1], cc[0, g, 2] = motion[2] * motion[2], 0.0, motion[0] * motion[0]
    cout[0], cw[0] = 0.0, 0.0


@njit(cache=True)
def _told(z, r, i, j, cx, cv, cc):  # pragma: no cover - compiled
    """Candidate j: i after measurement z with variances r (across, along); the logarithm of its likelihood."""
    like = 0.0
    for d in range(3):
        g = 1 if d == 2 else 0
        total = cc[i, g, 0] + r[g]
        off = z[d] - cx[i, d]
        like -= 0.5 * (off * off / total + math.log(2.0 * math.pi * total))
        cx[j, d] = cx[i, d] + cc[i, g, 0] / total * off
        cv[j, d] = cv[i, d] + cc[i, g, 1] / total * off
    for g in range(2):
        a, b = cc[i, g, 0], cc[i, g, 1]
        total = a + r[g]
        cc[j, g, 0] = a - a * a / total
        cc[j, g, 1] = b - a * b / total
        cc[j, g, 2] = cc[i, g, 2] - b * b / total
    return like


@njit(cache=True)
def _again(z, last, r, share):  # pragma: no cover - compiled
    """Logarithm of an outlier's density after one at `last`: it stays there, or jumps to anywhere (one in a m^3)."""
    if math.isnan(last[0]):
        return 0.0
    square, norm = 0.0, 1.0
    for d in range(3):
        total = 2.0 * r[1 if d == 2 else 0]
        square += (z[d] - last[d]) ** 2 / total
        norm *= 2.0 * math.pi * total
    return math.log(share * math.exp(-0.5 * square) / math.sqrt(norm) + 1.0 - share)


@njit(cache=True)
def _parted(z, last, logit, bone, r, speed, drift, rules, parts, count):  # pragma: no cover - compiled
    """Part every candidate: z is right or an outlier; and one more, that all before was wrong. Their number."""
    cx, cv, cc, cout, cw = parts
    stay, clutter, again = rules[0], rules[1], rules[2]
    had = count
    same = _again(z, last, r, rules[5])
    for i in range(had):
        odds = logit - bone - stay * cout[i]
        yes = -math.log1p(math.exp(-odds)) if odds > -30.0 else odds
        no = yes - odds
        cw[count] = cw[i] + yes + _told(z, r, i, count, cx, cv, cc)
        cout[count] = 0.0
        count += 1
        cw[i] += no + (same if cout[i] > 0.5 else clutter)
        cout[i] = 1.0
    for d in range(3):
        cx[count, d], cv[count, d] = z[d], drift[d]
    for g in range(2):
        cc[count, g, 0], cc[count, g, 1], cc[count, g, 2] = r[g], 0.0, speed * speed
    cout[count] = 0.0
    cw[count] = again + clutter - math.log1p(math.exp(bone - logit)) if had > 0 else 0.0
    return count + 1


@njit(cache=True)
def _kept(story, kept, used):  # pragma: no cover - compiled
    """Put the first `used` of the merged candidates back as stories whose weights sum to one."""
    x, v, c, weight, out = story
    total = 0.0
    for i in range(used):
        total += kept[4][i]
    for i in range(weight.size):
        weight[i] = kept[4][i] / total if i < used else 0.0
        if i < used:
            x[i], v[i], c[i], out[i] = kept[0][i], kept[1][i], kept[2][i], kept[3][i]


@njit(cache=True)
def _summed(story, mean, spread):  # pragma: no cover - compiled
    """Mean and covariance of a keypoint's stories."""
    x, _, c, weight, _ = story
    mean[:] = 0.0
    spread[:] = 0.0
    for i in range(weight.size):
        for d in range(3):
            mean[d] += weight[i] * x[i, d]
    for i in range(weight.size):
        w = weight[i]
        for d in range(3):
            spread[d, d] += w * c[i, 1 if d == 2 else 0, 0]
            for e in range(3):
                spread[d, e] += w * (x[i, d] - mean[d]) * (x[i, e] - mean[e])


@njit(cache=True)
def hypotheses_step(
    x, v, c, weight, out, last, z, logit, r, dt, drift, motion, parent, length, rest, slack, rules, mean, spread, right
):  # pragma: no cover - compiled
    """One frame of every keypoint's hypotheses, in place; twin: `body.stories_numpy.hypotheses_step_numpy`.

    x, v (q, 12, n, 3), c (q, 12, n, 2, 3) variances (place, both, speed) across and along the view, weight and out
    (q, 12, n), last (q, 12, 3); z (q, 12, 3) NaN unseen, logit (q, 12), r (q, 12, 2), drift (q, 3), motion (12, 4),
    parent (12,), length (q, 12), rest (q, 12, 3) from the parent, both NaN where unknown. Fills mean (q, 12, 3), spread
    (q, 12, 3, 3), right (q, 12); in the first two, keypoint 1 is that of a moment ago on entry.
    """
    q, n = x.shape[0], x.shape[2]
    m = 2 * n + 1
    parts = (np.empty((m, 3)), np.empty((m, 3)), np.empty((m, 2, 3)), np.empty(m), np.empty(m))
    cx, cv, cc, cout, cw = parts
    ease = 1.0 - math.exp(-dt / rules[6])
    kept = (np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 2, 3)), np.empty(n), np.empty(n))
    for who in range(q):
        for k in range(12):
            story = (x[who, k], v[who, k], c[who, k], weight[who, k], out[who, k])
            seen = not math.isnan(z[who, k, 0])
            up, long = parent[k], length[who, k]
            limb = up >= 0 and not math.isnan(long) and not math.isnan(mean[who, max(up, 0), 0])
            bone, give = 0.0, 1.0
            if limb:
                give = slack * slack + (spread[who, up, 0, 0] + spread[who, up, 1, 1] + spread[who, up, 2, 2]) / 3.0
            if limb and seen:
                off = math.sqrt(((z[who, k] - mean[who, up]) ** 2).sum()) - long
                bone = min(0.5 * off * off / give, rules[4])
            count = 0
            for i in range(n):
                if weight[who, k, i] > 0.0:
                    _moved(story, i, drift[who], dt, motion[k], (cx, cv, cc, cout, cw, count))
                    if limb:
                        _pulled(cx, cc, count, mean[who, up], rest[who, k], ease, long, give)
                    count += 1
            if count == 0 and limb:
                _begun(mean[who, up], rest[who, k], drift[who], motion[k], parts)
                count = 1
            right[who, k] = 0.0
            if count == 0 and (not seen or logit[who, k] < rules[7]):
                mean[who, k] = np.nan
                continue
            if seen:
                count = _parted(
                    z[who, k],
                    last[who, k],
                    logit[who, k],
                    bone,
                    r[who, k],
                    motion[k, 0],
                    drift[who],
                    rules,
                    parts,
                    count,
                )
                last[who, k] = z[who, k]
            top = cw[:count].max()
            total = 0.0
            for i in range(count):
                cw[i] = math.exp(cw[i] - top)
                total += cw[i]
            for i in range(count):
                cw[i] /= total
                if seen:
                    right[who, k] += cw[i] * (1.0 - cout[i])
            used = _merged(cx, cv, cc, cout, cw, np.argsort(-cw[:count]), n, rules[3], kept)
            _kept(story, kept, used)
            _summed(story, mean[who, k], spread[who, k])
