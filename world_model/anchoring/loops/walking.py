"""How movers go on: constant velocity with accelerations, and a heading that diffuses; compiled."""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True)
def flow(x, P, dt, q):  # type: ignore[no-untyped-def]
    """Constant velocity over dt with white acceleration of density q, in place."""
    for a in range(3):
        x[a] += dt * x[a + 3]
    for a in range(3):
        for b in range(3):
            P[a, b] += dt * (P[a + 3, b] + P[a, b + 3]) + dt * dt * P[a + 3, b + 3]
    for a in range(3):
        for b in range(3):
            P[a, b + 3] += dt * P[a + 3, b + 3]
    for a in range(3):
        for b in range(3):
            P[b + 3, a] = P[a, b + 3]
    for a in range(3):
        P[a, a] += q * dt**3 / 3.0
        P[a, a + 3] += 0.5 * q * dt**2
        P[a + 3, a] = P[a, a + 3]
        P[a + 3, a + 3] += q * dt


@numba.njit(cache=True)
def walk(leaves, i, dt, q, turning):  # type: ignore[no-untyped-def]
    """A mover over dt: white acceleration of density q, and a heading that diffuses by `turning` rad per root second.

    A heading that diffuses leaves the speed as it is: dv = -turning²/2 v dt + turning v⊥ dW. The noise across enters
    mean and covariance by E[|v|² I - v v'] alone, so that they follow from those before.
    """
    x, P = leaves.moving[i], leaves.moving_cov[i]
    if turning <= 0.0:
        flow(x, P, dt, q)
        return
    fade = 0.5 * turning * turning
    slower = np.exp(-fade * dt)
    along = (1.0 - slower) / fade
    twice = (1.0 - slower * slower) / (2.0 * fade)
    # Integrals of white noise of unit density through position and velocity.
    place = max(dt - 2.0 * along + twice, 0.0) / fade**2
    both = 0.5 * along * along
    if fade * dt < 1e-2:
        place, both = dt**3 / 3.0, 0.5 * dt**2
    noise = np.zeros((3, 3))
    square = P[3, 3] + P[4, 4] + x[3] ** 2 + x[4] ** 2
    for a in range(3):
        noise[a, a] = q
    for a in range(2):
        noise[a, a] += turning**2 * square
        for b in range(2):
            noise[a, b] -= turning**2 * (P[a + 3, b + 3] + x[a + 3] * x[b + 3])
    F = np.eye(6)
    for a in range(3):
        F[a, a + 3] = along if a < 2 else dt
        F[a + 3, a + 3] = slower if a < 2 else 1.0
    ahead, spread = F @ x, F @ P @ F.T
    for a in range(6):
        x[a] = ahead[a]
        for b in range(6):
            P[a, b] = spread[a, b]
    for a in range(3):
        for b in range(3):
            n = noise[a, b]
            P[a, b] += n * place
            P[a, b + 3] += n * both
            P[b + 3, a] += n * both
            P[a + 3, b + 3] += n * twice
