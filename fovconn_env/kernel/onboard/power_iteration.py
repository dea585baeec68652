"""lambda2 and v2, estimated on board by power iteration over PI consensus (docs/decisions.md), after [9] of the paper.

Yang et al., Automatica 2010 (power iteration); Freeman, Yang and Lynch, CDC 2006 (PI consensus). Both ends of a link
use the values both of them sent in the same round, so that what one adds the other takes away. Where a message is lost
its reader holds the last one: leaving the neighbour out would take its share out of L x, and so out of lambda2. Only
the differences of y, which vanish, are left out then: they alone enter the integral states, whose sum must stay 0.
"""

from __future__ import annotations

import math

from fovconn_env.kernel.jit import kernel
from fovconn_env.kernel.maths.weights import view_weight

POWER, FLOODING, TRUE, NONE = range(4)  # scenarios.params.SWITCHES["lambda2"]
LIMIT = 1e4


@kernel
def init_estimate(belief, x):
    """Start robot i's estimator from a random entry x of the eigenvector; x = 0 for all would stay 0."""
    belief.x = belief.y1 = x
    belief.y2 = x * x
    belief.y3 = belief.q1 = belief.q2 = belief.q3 = belief.degree = 0.0
    belief.lambda2_hat = belief.v2_hat = 0.0


@kernel
def bounded(value):
    """A state kept finite, far outside its working range of about N: with most messages lost the sums run away."""
    return min(max(value, -LIMIT), LIMIT)


@kernel
def agreed_weight(sent, received, p):
    """A_ij (6) from what i sent to j and received from j in the same round; the same bits at both ends."""
    share = 0.5 if sent.seen == received.seen else 1.0  # case 2 of Sec. III-C: only one of them measures
    weight = share * (sent.gamma + received.gamma) * view_weight(sent.f, received.f, p.weight)
    return weight if sent.seen | received.seen else 0.0


@kernel
def agree_weight(track, sent, inbox, p):
    """Update robot i's weight of its link to j, from its own message to j and the one of the same round from j."""
    if inbox.news:
        track.weight = agreed_weight(sent, inbox, p)
    elif inbox.age >= p.memory:
        track.weight = 0.0


@kernel
def power_round(belief, peers, sent, contacts, p):
    """Run one round of robot i, from its own last broadcast part (`sent`) and the messages of the same round (inboxes).

    Where messages travel for L rounds it runs once in L rounds, so that robot i still holds what it sent.
    """
    lx = m1 = m2 = m3 = n1 = n2 = n3 = degree = strength = 0.0
    for j in contacts:
        peer = peers[j]
        received = peer.inbox
        if received.age >= p.memory:
            continue
        w = 1.0 / (1.0 + max(sent.degree, received.degree))  # Metropolis weight
        degree += 1.0
        strength += peer.track.weight
        lx += peer.track.weight * (sent.x - received.x)  # (L x)_i
        n1 += w * (sent.q1 - received.q1)  # (M q)_i
        n2 += w * (sent.q2 - received.q2)
        n3 += w * (sent.q3 - received.q3)
        if received.fresh:
            m1 += w * (sent.y1 - received.y1)  # (M y)_i
            m2 += w * (sent.y2 - received.y2)
            m3 += w * (sent.y3 - received.y3)
    x, y1 = belief.x, belief.y1
    belief.degree = degree
    g, kp, ki = p.power_g, p.power_kp, p.power_ki
    belief.y1 = bounded(belief.y1 + g * (x - belief.y1) - kp * m1 + ki * n1)  # mean of x
    belief.y2 = bounded(belief.y2 + g * (x * x - belief.y2) - kp * m2 + ki * n2)  # mean of x^2
    belief.y3 = bounded(belief.y3 + g * (x * lx - belief.y3) - kp * m3 + ki * n3)  # mean of x (L x)
    belief.q1 = bounded(belief.q1 - ki * m1)
    belief.q2 = bounded(belief.q2 - ki * m2)
    belief.q3 = bounded(belief.q3 - ki * m3)
    mean = belief.y1 + p.power_lead * (belief.y1 - y1)  # looks ahead: y1 lags by 1 / g rounds
    excess = belief.y2 - 1.0
    x_next = (x - p.power_k1 * mean - p.power_k2 * lx) / (1.0 + p.power_k3 * max(excess, 0.0))
    n = peers.shape[0]
    bound = strength * n / (n - 1.0)  # lambda2 is not above it (Fiedler 1973); where lambda2_hat is, i is coming loose
    push = p.power_k2 * max(rayleigh(belief.y2, belief.y3, n) - bound, 0.0)
    belief.x = bounded(x_next - p.power_k3 * min(excess, 0.0) * x + math.copysign(push, x - mean))


@kernel
def rayleigh(y2, y3, n):
    """lambda2_hat of n robots from the means of x^2 and x (L x): the Rayleigh quotient."""
    return min(max(y3 / max(y2, 1e-6), 0.0), float(n))


@kernel
def read_estimate(belief, n):
    """Robot i's estimates of lambda2 and of its entry of v2, from its state; n robots."""
    belief.lambda2_hat = rayleigh(belief.y2, belief.y3, n)
    belief.v2_hat = belief.x / math.sqrt(n * max(belief.y2, 1e-6))


@kernel
def set_estimate(belief, lambda2, v2, n):
    """Put a lambda2 and an entry of v2 from elsewhere into robot i's belief, in the form its messages carry."""
    belief.x = v2 * math.sqrt(n)
    belief.y2, belief.y3 = 1.0, lambda2
    belief.lambda2_hat, belief.v2_hat = lambda2, v2
