"""The smoothing pass as loops over floats, for numba: 100 to 1000 times faster than the definition with one series.

`linear_pass` is the definition; the tests hold the two together. Compiled once for any size, and for the sizes in SIZES
again, since loops of known length take less than half the time. Measurements enter one component at a time, and
so does process noise where information runs backward, which needs no inverse of a matrix. Factors of inner loops have
names of their own, because a compiler cannot know that storing into one array leaves another as it was.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit

# An ordinary measurement may use the short form of P; one that tells this much more than was known before, as next to
# a diffuse prior, needs Joseph's, or P loses its last digits (twice this ratio of them). Where there was one, the
# smoothed states take the longer way too: it costs as much as another pass.
_SHARP = 100.0

_inner = njit(nogil=True, error_model="numpy")


@_inner
def _take_in(x, P, y, Y):
    """Correct x and P by the information exp(-x'Y x/2 + y'x), as n components of Y = L D L'; y and Y are used up."""
    n = len(x)
    row, p, k = np.zeros(n), np.zeros(n), np.zeros(n)
    for c in range(n):
        pivot, potential = Y[c, c], y[c]
        if pivot <= 0.0:
            continue
        predicted, variance = 0.0, 0.0
        for i in range(n):
            row[i] = Y[c, i] / pivot if i >= c else 0.0
        for i in range(n):
            p[i] = 0.0
            for j in range(n):
                p[i] += P[i, j] * row[j]
            predicted += row[i] * x[i]
            variance += p[i] * row[i]
        left = 1.0 / (1.0 + pivot * variance)
        for i in range(n):
            x[i] += p[i] * (potential - pivot * predicted) * left
            for j in range(n):
                P[i, j] -= pivot * left * p[i] * p[j]
        for i in range(n):
            k[i] = 0.0
            for j in range(n):
                k[i] += P[i, j] * row[j]
        for i in range(n):
            for j in range(n):
                P[i, j] += pivot * left * (p[i] * left - k[i]) * p[j]
        for i in range(n):
            y[i] -= row[i] * potential
            for j in range(n):
                Y[i, j] -= pivot * row[i] * row[j]


@_inner
def _go_back(y, Y, F, G, c, H, z, d, o, scale):
    """Turn the information about the state after a step into that about the state before it."""
    n, m, r = len(y), len(d), G.shape[1]
    p = np.zeros(n)
    for v in range(m):
        for i in range(n):
            y[i] += (d[v] * z[v] + o[v]) * H[v, i]
            for j in range(n):
                Y[i, j] += d[v] * H[v, i] * H[v, j]
    for i in range(n):
        for j in range(n):
            y[i] -= Y[i, j] * c[j]
    for l in range(r):
        variance, part = 0.0, 0.0
        for i in range(n):
            p[i] = 0.0
            for j in range(n):
                p[i] += Y[i, j] * G[j, l]
            part += G[i, l] * y[i]
            variance += p[i] * G[i, l]
        taken = scale / (1.0 + scale * variance)
        for i in range(n):
            y[i] -= taken * p[i] * part
            for j in range(n):
                Y[i, j] -= taken * p[i] * p[j]
    _between(F, y, Y, y, Y)


@_inner
def _between(F, s, L, s_to, L_to):
    """Write F's and F'L F, symmetric to the last bit."""
    n = len(s)
    Fs, LF = np.zeros(n), np.zeros((n, n))
    for i in range(n):
        for j in range(n):
            Fs[i] += F[j, i] * s[j]
            for l in range(n):
                LF[i, j] += L[i, l] * F[l, j]
    for i in range(n):
        s_to[i] = Fs[i]
        for j in range(i + 1):
            total = 0.0
            for l in range(n):
                total += F[l, i] * LF[l, j]
            L_to[i, j] = L_to[j, i] = total


@lru_cache
def compiled_for(states: int, sensors: int) -> Any:
    """Return the pass for so many states and sensors, 0 for any."""

    @njit(cache=True, nogil=True, error_model="numpy")
    def run(F, G, c, H, z, x0, P0, d, o, q, fitted, spread, score, information, xs, Ps, x0s, P0s):
        """Smooth every series; arguments as the fields of Model, Weighting and Smooth."""
        series, steps, r = d.shape[0], d.shape[1], G.shape[3]
        # Sums, since numba would type everything anew for each literal; LLVM still knows their values.
        n, m = states + 0 if states > 0 else F.shape[3], sensors + 0 if sensors > 0 else d.shape[2]
        wanted, process = xs.shape[1] > 0, score.shape[1] > 0
        every_F, every_G, every_H = F.shape[1] > 1, G.shape[1] > 1, H.shape[1] > 1
        x, x_next, p, k = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
        y, taken_y, Y, taken_Y = np.zeros(n), np.zeros(n), np.zeros((n, n)), np.zeros((n, n))
        P, A, Ft, FT, Q = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
        Ht, B, V, GL = np.zeros((m, n)), np.zeros((m, n)), np.zeros((m, m)), np.zeros((r, n))
        Hx, PH = np.empty((steps, m)), np.empty((steps, m, n))
        for one in range(series):
            sF, sG, sc, sH = one % F.shape[0], one % G.shape[0], one % c.shape[0], one % H.shape[0]
            s0 = one % x0.shape[0], one % P0.shape[0]
            for i in range(n):
                x[i] = x0[s0[0], i]
                for j in range(n):
                    P[i, j] = P0[s0[1], i, j]
            sharp = False
            for t in range(steps):
                tc = t % c.shape[1]
                if t == 0 or every_F:
                    for i in range(n):
                        for j in range(n):
                            Ft[i, j] = F[sF, t, i, j]
                            FT[j, i] = Ft[i, j]
                if t == 0 or every_G:
                    for i in range(n):
                        for j in range(n):
                            total = 0.0
                            for l in range(r):
                                total += G[sG, t, i, l] * G[sG, t, j, l]
                            Q[i, j] = total
                if t == 0 or every_H:
                    for v in range(m):
                        for i in range(n):
                            Ht[v, i] = H[sH, t, v, i]
                # Predict.
                scale = q[one, t]
                for i in range(n):
                    total = c[sc, tc, i]
                    for j in range(n):
                        total += Ft[i, j] * x[j]
                        A[i, j] = 0.0
                    x_next[i] = total
                    for l in range(n):
                        f = Ft[i, l]
                        for j in range(n):
                            A[i, j] += f * P[l, j]
                for i in range(n):
                    x[i] = x_next[i]
                    for j in range(n):
                        P[i, j] = Q[i, j] * scale
                    for l in range(n):
                        f = A[i, l]
                        for j in range(n):
                            P[i, j] += f * FT[l, j]
                # Correct, one component at a time.
                for v in range(m):
                    precision = d[one, t, v]
                    if precision == 0.0 and o[one, t, v] == 0.0:
                        continue
                    predicted, variance = 0.0, 0.0
                    for i in range(n):
                        p[i] = 0.0
                    for j in range(n):
                        h = Ht[v, j]
                        predicted += h * x[j]
                        for i in range(n):
                            p[i] += P[j, i] * h
                    for i in range(n):
                        variance += p[i] * Ht[v, i]
                    left = 1.0 / (1.0 + precision * variance)
                    gain = (precision * (z[one, t, v] - predicted) + o[one, t, v]) * left
                    taken = precision * left
                    for i in range(n):
                        x[i] += p[i] * gain
                        f = taken * p[i]
                        for j in range(n):
                            P[i, j] -= f * p[j]
                    if precision * variance > _SHARP:
                        sharp = True
                        for i in range(n):
                            k[i] = 0.0
                            for j in range(n):
                                k[i] += P[i, j] * Ht[v, j]
                        for i in range(n):
                            f = taken * (p[i] * left - k[i])
                            for j in range(n):
                                P[i, j] += f * p[j]
                for i in range(n):
                    for j in range(i):
                        P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])
                for v in range(m):
                    total = 0.0
                    for i in range(n):
                        PH[t, v, i] = 0.0
                    for j in range(n):
                        h = Ht[v, j]
                        total += h * x[j]
                        for i in range(n):
                            PH[t, v, i] += P[j, i] * h
                    Hx[t, v] = total
                if wanted:
                    for i in range(n):
                        xs[one, t, i] = x[i]
                        for j in range(n):
                            Ps[one, t, i, j] = P[i, j]
            # Backward: score s and information L, in the arrays of x and P; with care also y and Y.
            s, L, careful = x, P, wanted and sharp
            for i in range(n):
                s[i] = y[i] = 0.0
                for j in range(n):
                    L[i, j] = Y[i, j] = 0.0
            for t in range(steps - 1, -1, -1):
                if every_H:
                    for v in range(m):
                        for i in range(n):
                            Ht[v, i] = H[sH, t, v, i]
                if careful:
                    taken_y[:] = y
                    taken_Y[:] = Y
                    _take_in(xs[one, t], Ps[one, t], taken_y, taken_Y)
                    tc, tG, tH = t % c.shape[1], t % G.shape[1], t % H.shape[1]
                    _go_back(
                        y, Y, F[sF, t % F.shape[1]], G[sG, tG], c[sc, tc], H[sH, tH], z[one, t], d[one, t], o[one, t],
                        q[one, t],
                    )  # fmt: skip
                elif wanted:
                    for i in range(n):
                        total = xs[one, t, i]
                        for j in range(n):
                            total += Ps[one, t, i, j] * s[j]
                            A[i, j] = 0.0
                        x_next[i] = total
                        for l in range(n):
                            f = Ps[one, t, i, l]
                            for j in range(n):
                                A[i, j] += f * L[l, j]
                    for i in range(n):
                        xs[one, t, i] = x_next[i]
                        for j in range(n):
                            Q[i, j] = Ps[one, t, i, j]
                    for i in range(n):
                        for l in range(n):
                            f = A[i, l]
                            for j in range(n):
                                Ps[one, t, i, j] -= f * Q[l, j]
                for v in range(m):
                    total = Hx[t, v]
                    for i in range(n):
                        B[v, i] = 0.0
                    for j in range(n):
                        f = PH[t, v, j]
                        total += f * s[j]
                        for i in range(n):
                            B[v, i] += L[j, i] * f
                    fitted[one, t, v] = total
                    for u in range(v + 1):
                        total = 0.0
                        for i in range(n):
                            total += Ht[u, i] * PH[t, v, i] - B[v, i] * PH[t, u, i]
                        V[u, v] = V[v, u] = total
                for v in range(m):
                    for u in range(m):
                        spread[one, t, v, u] = V[v, u]
                    precision = d[one, t, v]
                    push = precision * (z[one, t, v] - fitted[one, t, v]) + o[one, t, v]
                    # L += h k' + k h' with k = d (h - V d H)/2 - d B.
                    for i in range(n):
                        k[i] = precision * (0.5 * Ht[v, i] - B[v, i])
                    for u in range(m):
                        f = 0.5 * precision * V[v, u] * d[one, t, u]
                        for i in range(n):
                            k[i] -= f * Ht[u, i]
                    for i in range(n):
                        h, f = Ht[v, i], k[i]
                        s[i] += h * push
                        for j in range(n):
                            L[i, j] += h * k[j] + f * Ht[v, j]
                if process:
                    tG = t % G.shape[1]
                    for a in range(r):
                        total = 0.0
                        for j in range(n):
                            total += G[sG, tG, j, a] * s[j]
                            GL[a, j] = 0.0
                        score[one, t, a] = total
                        for l in range(n):
                            f = G[sG, tG, l, a]
                            for j in range(n):
                                GL[a, j] += f * L[l, j]
                        for b in range(a + 1):
                            total = 0.0
                            for j in range(n):
                                total += GL[a, j] * G[sG, tG, j, b]
                            information[one, t, a, b] = information[one, t, b, a] = total
                if every_F:
                    for i in range(n):
                        for j in range(n):
                            Ft[i, j] = F[sF, t, i, j]
                            FT[j, i] = Ft[i, j]
                for i in range(n):
                    total = 0.0
                    for j in range(n):
                        total += FT[i, j] * s[j]
                        A[i, j] = 0.0
                    x_next[i] = total
                    for l in range(n):
                        f = FT[i, l]
                        for j in range(n):
                            A[i, j] += f * L[l, j]
                for i in range(n):
                    s[i] = x_next[i]
                    for j in range(n):
                        L[i, j] = 0.0
                    for l in range(n):
                        f = A[i, l]
                        for j in range(n):
                            L[i, j] += f * Ft[l, j]
                for i in range(n):
                    for j in range(i):
                        L[i, j] = L[j, i] = 0.5 * (L[i, j] + L[j, i])
            x0s[one] = x0[s0[0]]
            P0s[one] = P0[s0[1]]
            if careful:
                _take_in(x0s[one], P0s[one], y, Y)
            else:
                _between(P0[s0[1]], s, L, x_next, A)
                x0s[one] += x_next
                P0s[one] -= A

    return run
