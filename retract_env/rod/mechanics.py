"""The rod as in a textbook: kinematics, strains, energy, and what bed and block do to it. Simo & Reissner.

A planar rod, geometrically exact, that bends, stretches and shears. Lengths are in flap heights h, forces in
E h d, with E the tissue's Young's modulus and d the flap's depth; so a section of plain tissue has unit
stiffness against stretching, and 1/12 against bending.

Kinematics. The axis is the curve (x, y)(s), s along the flap at rest from the free to the fixed end; a cross
section stays plane and stands at the angle theta, 0 at rest, so that the point at height z above the axis is
(x - z sin theta, y + z cos theta).

Strains, with ' = d/ds:
    stretch of the axis        e = x' cos theta + y' sin theta - 1
    shear                      g = y' cos theta - x' sin theta
    curvature                  k = theta'
A fibre at height z stretches by e - z k.

Slack. Where nothing pulls, the axis of a bent flap is longer than at rest: the tissue is stiffer pressed than
pulled (its stress goes as t - t^2 with the stretch t), and the pressed half is thicker, the pulled one
thinner, by Poisson's ratio n, which moves the axis outwards. To second order in the curvature that stretch is
b k^2,
    b = (1 + 3 n / 2) / 12
for a section of plain tissue. (In plane strain of rubber the stress goes as t - 3/2 t^2 and n is 1, which
makes b = 1/4, as in Rivlin's exact solution of flexure.) What strains a section is e' = e - b k^2.

Energy per length, A, B, D and G the section's stiffness:
    U = (A e'^2 + 2 B e' k + D k^2 + G g^2) / 2
so that the normal force is N = A e' + B k, the moment M = B e' + D k - 2 b k N, the shear force Q = G g.

Along an element x', y' and theta' are constant, and theta is taken in its middle: one point of integration,
which neither locks nor hourglasses.

Weight acts on the axis. The bed y = 0 pushes the flap's lower surface (z = -1/2), the block x > 0, y < 1 that
holds the fixed end both surfaces, with a stiffness per length; the block along the shorter way out, so that
nothing jumps at its corner.
"""

from __future__ import annotations

import math

from numba import njit

CONTRACT = {"contract", "nsz"}
"""What the compiler may do with the formulas: fuse a product and a sum. It does so for every lane alike."""

HALF_TURNS = 1 / math.pi
MAGIC = 1.5 * 2.0**52
"""Added and taken away again, it rounds a double to a whole number."""
PI_HIGH, PI_LOW = 3.141592653589793116, 1.2246467991473532e-16


@njit(fastmath=CONTRACT, error_model="numpy")
def sine_cosine(x):
    """sin x and cos x, to 1e-15 for |x| < 100, without branches or calls, so that lanes are computed at once.

    Taylor's series on half a turn: the last terms left out are below 1e-16.
    """
    turns = (x * HALF_TURNS + MAGIC) - MAGIC
    r = (x - turns * PI_HIGH) - turns * PI_LOW
    odd = turns - 2.0 * ((turns * 0.5 + MAGIC) - MAGIC)
    sign = 1.0 - 2.0 * odd * odd
    q = r * r
    s, c = 1.0, 1.0
    # 1 - q / (2 3) (1 - q / (4 5) (1 - ...)), and the same for the cosine; the loop is unrolled by hand
    s = 1.0 - q * (1.0 / 420.0)
    s = 1.0 - q * (1.0 / 342.0) * s
    s = 1.0 - q * (1.0 / 272.0) * s
    s = 1.0 - q * (1.0 / 210.0) * s
    s = 1.0 - q * (1.0 / 156.0) * s
    s = 1.0 - q * (1.0 / 110.0) * s
    s = 1.0 - q * (1.0 / 72.0) * s
    s = 1.0 - q * (1.0 / 42.0) * s
    s = 1.0 - q * (1.0 / 20.0) * s
    s = 1.0 - q * (1.0 / 6.0) * s
    c = 1.0 - q * (1.0 / 462.0)
    c = 1.0 - q * (1.0 / 380.0) * c
    c = 1.0 - q * (1.0 / 306.0) * c
    c = 1.0 - q * (1.0 / 240.0) * c
    c = 1.0 - q * (1.0 / 182.0) * c
    c = 1.0 - q * (1.0 / 132.0) * c
    c = 1.0 - q * (1.0 / 90.0) * c
    c = 1.0 - q * (1.0 / 56.0) * c
    c = 1.0 - q * (1.0 / 30.0) * c
    c = 1.0 - q * (1.0 / 12.0) * c
    c = 1.0 - q * (1.0 / 2.0) * c
    return sign * r * s, sign * c


@njit(fastmath=CONTRACT, error_model="numpy")
def strains(dx, dy, sine, cosine):
    """Stretch of the axis and shear where x' = dx, y' = dy and the section stands at theta."""
    return cosine * dx + sine * dy - 1.0, cosine * dy - sine * dx


@njit(fastmath=CONTRACT, error_model="numpy")
def energy(stretch, shear, bend, A, B, D, G, b):
    """U, per length; bend is the curvature, b the slack."""
    stretch = stretch - b * bend * bend
    return 0.5 * (A * stretch * stretch + D * bend * bend + G * shear * shear) + B * stretch * bend


@njit(fastmath=CONTRACT, error_model="numpy")
def gradient(stretch, shear, bend, sine, cosine, A, B, D, G, b):
    """dU over x', y', theta and theta': the force (2) along the rod, N g - Q (1 + e), and the moment."""
    strained = stretch - b * bend * bend
    N, Q = A * strained + B * bend, G * shear
    M = B * strained + D * bend - 2.0 * b * bend * N
    return (
        cosine * N - sine * Q,
        sine * N + cosine * Q,
        N * shear - Q * (1.0 + stretch),
        M,
    )


@njit(fastmath=CONTRACT, error_model="numpy")
def hessian(stretch, shear, bend, sine, cosine, A, B, D, G, b):
    """Second derivatives of U over (x', y', theta, theta'): xx, xy, yy, xt, yt, tt, xk, yk, tk, kk."""
    s, c, e = sine, cosine, 1.0 + stretch
    N, Q = A * (stretch - b * bend * bend) + B * bend, G * shear
    turn = 2.0 * b * bend
    D += turn * turn * A - 2.0 * turn * B - 2.0 * b * N
    B -= turn * A
    fx, fy = c * N - s * Q, s * N + c * Q
    return (
        A * c * c + G * s * s,
        (A - G) * c * s,
        A * s * s + G * c * c,
        A * c * shear + G * s * e - fy,
        A * s * shear - G * c * e + fx,
        A * shear * shear + G * e * e - N * e - Q * shear,
        B * c,
        B * s,
        B * shear,
        D,
    )


@njit(fastmath=CONTRACT, error_model="numpy")
def resting(y, sine, cosine, bed):
    """What the bed does to the section at height y, per length, by its stiffness (0 where there is none).

    Returns energy; its gradient over y and theta; its second derivatives yy, yt, tt.
    """
    dx, dy = 0.5 * cosine, 0.5 * sine
    below = max(dx - y, 0.0)
    push = -bed * below
    stiff = bed if below > 0.0 else 0.0
    return 0.5 * bed * below * below, push, push * dy, stiff, stiff * dy, stiff * dy * dy + push * dx


@njit(fastmath=CONTRACT, error_model="numpy")
def blocked(x, y, sine, cosine, block):
    """What the block does to both surfaces of the section at (x, y), likewise: nothing unless x > -1/2.

    Returns energy; its gradient over x, y, theta; its second derivatives xx, yy, xt, yt, tt.
    """
    dx, dy = 0.5 * cosine, 0.5 * sine
    low, gx, gy, kx, ky = _pushed_out(x + dy, y - dx, block)
    high, hx, hy, mx, my = _pushed_out(x - dy, y + dx, block)
    # the upper surface turns as the lower one does, but for the sign
    px, py = gx - hx, gy - hy
    return (
        low + high,
        gx + hx,
        gy + hy,
        px * dx + py * dy,
        kx + mx,
        ky + my,
        (kx - mx) * dx,
        (ky - my) * dy,
        (kx + mx) * dx * dx + (ky + my) * dy * dy - px * dy + py * dx,
    )


@njit(fastmath=CONTRACT, error_model="numpy")
def _pushed_out(x, y, block):
    """Energy of a point in the block, its gradient over x and y, and its second derivatives xx and yy."""
    deep, aside = max(1.0 - y, 0.0), max(x, 0.0)
    leftwards = block if aside < deep else 0.0
    upwards = block - leftwards
    return (
        0.5 * (leftwards * aside * aside + upwards * deep * deep),
        leftwards * aside,
        -upwards * deep,
        leftwards if aside > 0.0 else 0.0,
        upwards if deep > 0.0 else 0.0,
    )
