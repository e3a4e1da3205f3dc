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
def hypotheses_step(
    x, v, c, weight, out, z, logit, r, dt, drift, motion, parent, length, slack, rules, mean, spread, right
):  # pragma: no cover - compiled
    """One frame of every keypoint's hypotheses, in place; see `body.permanence.robust_step`.

    x, v (q, 12, n, 3), c (q, 12, n, 2, 3) variances (place, both, speed) across and along the view, weight and out
    (q, 12, n); z (q, 12, 3) NaN unseen, logit (q, 12), r (q, 12, 2), drift (q, 3), motion (12, 4), parent (12,), length
    (q, 12) NaN unknown. Fills mean (q, 12, 3), spread (q, 12, 3, 3), right (q, 12).
    """
    q, n = x.shape[0], x.shape[2]
    stay, clutter, again, near, least = rules[0], rules[1], rules[2], rules[3], rules[4]
    m = 2 * n + 1
    cx, cv, cc = np.empty((m, 3)), np.empty((m, 3)), np.empty((m, 2, 3))
    cout, cw = np.empty(m), np.empty(m)
    kept = (np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 2, 3)), np.empty(n), np.empty(n))
    for who in range(q):
        for k in range(12):
            speed, tau, cap, shake = motion[k, 0], motion[k, 1], motion[k, 2], motion[k, 3]
            decay = math.exp(-dt / tau)
            reach = tau * (1.0 - decay)
            power = 2.0 * speed * speed / tau
            seen = not math.isnan(z[who, k, 0])
            up, long = parent[k], length[who, k]
            limb = up >= 0 and not math.isnan(long) and not math.isnan(mean[who, max(up, 0), 0])
            bone = 0.0
            give = 1.0
            if limb:
                give = slack * slack + (spread[who, up, 0, 0] + spread[who, up, 1, 1] + spread[who, up, 2, 2]) / 3.0
            if limb and seen:
                apart = 0.0
                for d in range(3):
                    apart += (z[who, k, d] - mean[who, up, d]) ** 2
                off = math.sqrt(apart) - long
                bone = min(0.5 * off * off / give, least)
            top = -math.inf
            count = 0
            for i in range(n):
                w = weight[who, k, i]
                if not w > 0.0:
                    continue
                for d in range(3):
                    u = drift[who, d]
                    own = v[who, k, i, d] - u
                    cx[count, d] = x[who, k, i, d] + u * dt + own * reach
                    cv[count, d] = u + own * decay
                for g in range(2):
                    pp, pv, vv = c[who, k, i, g, 0], c[who, k, i, g, 1], c[who, k, i, g, 2]
                    a = pp + 2.0 * reach * pv + reach * reach * vv + power * dt**3 / 3.0 + shake * dt
                    b = decay * (pv + reach * vv) + power * dt * dt / 2.0
                    e = decay * decay * vv + power * dt
                    if a > cap * cap:
                        b *= cap / math.sqrt(a)
                        a = cap * cap
                    cc[count, g, 0], cc[count, g, 1], cc[count, g, 2] = a, b, e
                if limb:
                    apart = 0.0
                    for d in range(3):
                        apart += (cx[count, d] - mean[who, up, d]) ** 2
                    apart = math.sqrt(apart)
                    pp = (2.0 * cc[count, 0, 0] + cc[count, 1, 0]) / 3.0
                    pull = 1.0 + pp / (pp + give) * (long - apart) / max(apart, 1e-6)
                    pull = max(pull, 0.0)
                    for d in range(3):
                        cx[count, d] = mean[who, up, d] + pull * (cx[count, d] - mean[who, up, d])
                cout[count] = out[who, k, i]
                cw[count] = math.log(w)
                top = max(top, cw[count])
                count += 1
            if count == 0 and not seen:
                right[who, k] = 0.0
                continue
            if seen:
                had = count
                for i in range(had):
                    odds = logit[who, k] - bone - stay * cout[i]
                    yes = -math.log1p(math.exp(-odds)) if odds > -30.0 else odds
                    no = yes - odds
                    j = count
                    like = 0.0
                    for d in range(3):
                        g = 1 if d == 2 else 0
                        total = cc[i, g, 0] + r[who, k, g]
                        off = z[who, k, d] - cx[i, d]
                        like -= 0.5 * (off * off / total + math.log(2.0 * math.pi * total))
                        cx[j, d] = cx[i, d] + cc[i, g, 0] / total * off
                        cv[j, d] = cv[i, d] + cc[i, g, 1] / total * off
                    for g in range(2):
                        total = cc[i, g, 0] + r[who, k, g]
                        a, b = cc[i, g, 0], cc[i, g, 1]
                        cc[j, g, 0] = a - a * a / total
                        cc[j, g, 1] = b - a * b / total
                        cc[j, g, 2] = cc[i, g, 2] - b * b / total
                    cout[j] = 0.0
                    cw[j] = cw[i] + yes + like
                    cw[i] += no + clutter
                    cout[i] = 1.0
                    count += 1
                for d in range(3):
                    cx[count, d] = z[who, k, d]
                    cv[count, d] = drift[who, d]
                for g in range(2):
                    cc[count, g, 0], cc[count, g, 1], cc[count, g, 2] = r[who, k, g], 0.0, speed * speed
                cout[count] = 0.0
                cw[count] = again + clutter - bone if had > 0 else 0.0
                count += 1
            top = -math.inf
            for i in range(count):
                top = max(top, cw[i])
            total, sure = 0.0, 0.0
            for i in range(count):
                cw[i] = math.exp(cw[i] - top)
                total += cw[i]
            for i in range(count):
                cw[i] /= total
                if seen:
                    sure += cw[i] * (1.0 - cout[i])
            right[who, k] = sure
            order = np.argsort(-cw[:count])
            used = _merged(cx, cv, cc, cout, cw, order, n, near, kept)
            total = 0.0
            for i in range(used):
                total += kept[4][i]
            for i in range(n):
                weight[who, k, i] = kept[4][i] / total if i < used else 0.0
                if i < used:
                    x[who, k, i], v[who, k, i], c[who, k, i] = kept[0][i], kept[1][i], kept[2][i]
                    out[who, k, i] = kept[3][i]
            for d in range(3):
                mean[who, k, d] = 0.0
                for e in range(3):
                    spread[who, k, d, e] = 0.0
            for i in range(used):
                for d in range(3):
                    mean[who, k, d] += weight[who, k, i] * x[who, k, i, d]
            for i in range(used):
                w = weight[who, k, i]
                for d in range(3):
                    g = 1 if d == 2 else 0
                    spread[who, k, d, d] += w * c[who, k, i, g, 0]
                    for e in range(3):
                        spread[who, k, d, e] += (
                            w * (x[who, k, i, d] - mean[who, k, d]) * (x[who, k, i, e] - mean[who, k, e])
                        )
