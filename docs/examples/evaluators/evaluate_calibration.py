"""Evaluates a calibration document (docs/model.md) with numpy alone.

python evaluate_calibration.py calibration.json project EAST NORTH UP      prints x y, px
python evaluate_calibration.py calibration.json back-project X Y           prints east north up
python evaluate_calibration.py calibration.json covariance EAST NORTH UP   prints xx xy yx yy of the pixel, px squared
python evaluate_calibration.py calibration.json holding X Y SHARE          prints the sigmas within which a share lies
"""

import json
import sys
from pathlib import Path

import numpy as np

IDEAL = {  # radius of an angle, angle of a radius
    "perspective": (np.tan, np.arctan),
    "equidistant": (lambda t: t, lambda r: r),
    "equisolid": (lambda t: 2 * np.sin(t / 2), lambda r: 2 * np.arcsin(r / 2)),
    "stereographic": (lambda t: 2 * np.tan(t / 2), lambda r: 2 * np.arctan(r / 2)),
    "orthographic": (np.sin, np.arcsin),
}
GROUPS = "focal_length_px skew_px principal_point_px rotation_cam_enu translation radial decentering".split()
NAMES = """focal_length_x_px focal_length_y_px skew_px principal_point_x_px principal_point_y_px rotation_x rotation_y
    rotation_z translation_x translation_y translation_z k2 k3 k4 k5 k6 k7 k8 k9 p1 p2 p3 p4""".split()


def rotation(w):
    """Matrix of a rotation vector, east-north-up to camera (Rodrigues)."""
    angle = np.linalg.norm(w)
    a = np.cross(np.eye(3), w / (angle or 1.0))
    return np.eye(3) + np.sin(angle) * a + (1 - np.cos(angle)) * a @ a


def shift(c, r, point):
    """Decentering in focal lengths of a point at radius r; c = p1 … p4 or q1 … q5."""
    u, v = point / r if r > 0 else (1.0, 0.0)
    g = r**2 * (1 + sum(k * r ** (2 * n) for n, k in enumerate(c[2:], 1)))
    return g * np.array([c[0] * (1 + 2 * u * u) + 2 * c[1] * u * v, 2 * c[0] * u * v + c[1] * (1 + 2 * v * v)])


def waves(field, pixel):
    """Basis of the field at a pixel; 0 beyond its box."""
    half = np.array(field["half_px"])
    place = (pixel - field["center_px"]) / half + 1
    values = np.prod(np.sin(0.5 * np.pi * np.array(field["orders"]).reshape(-1, 2) * place) / np.sqrt(half), axis=1)
    return values * (min(place) > 0 and max(place) < 2)


def displaced(document, pixel):
    """Pixel of the lens with the field's mean."""
    field = document["uncertainty"]["field"]
    return pixel + np.array(field["mean"]) @ waves(field, pixel)


def project(document, direction, p=None):
    """Pixel x, y of a unit vector, east-north-up; NaN beyond max_angle_deg. p: the 23 parameters, if not the file's."""
    m, image = document["model"], document["image"]
    p = np.hstack([m[group] for group in GROUPS]) if p is None else p
    ray = rotation(p[5:8]) @ direction + p[8:11]
    across = np.hypot(ray[0], ray[1])
    theta = np.arctan2(across, ray[2])
    if theta > np.radians(m["max_angle_deg"]):
        return np.array([np.nan, np.nan])
    r = IDEAL[m["projection"]][0](theta) + p[11:19] @ (theta / (np.pi / 2)) ** np.arange(2, 10)
    point = r * ray[:2] / across if across > 0 else np.zeros(2)
    point = point + shift(p[19:], r, point)
    x, y = p[0] * point[0] + p[2] * point[1] + p[3], p[1] * point[1] + p[4]
    return displaced(document, np.array([image["width"] - 1 - x if image["mirrored"] else x, y]))


def back_project(document, pixel):
    """Unit vector, east-north-up, of a pixel by the closed form; off by up to backward_model.max_error_px."""
    m, b, image = document["model"], document["backward_model"], document["image"]
    seen = pixel
    for _ in range(8):  # the field is taken out first
        pixel = seen - (displaced(document, pixel) - pixel)
    px = image["width"] - 1 - pixel[0] if image["mirrored"] else pixel[0]
    y = (pixel[1] - m["principal_point_px"][1]) / m["focal_length_px"][1]
    point = np.array([(px - m["principal_point_px"][0] - m["skew_px"] * y) / m["focal_length_px"][0], y])
    r = np.linalg.norm(point)
    point = point - shift(b["decentering"], r, point)
    adjusted = np.linalg.norm(point) or np.finfo(float).tiny
    theta = IDEAL[m["projection"]][1](adjusted - b["radial"] @ r ** np.arange(2, 10))
    return rotation(np.array(m["rotation_cam_enu"])).T @ [*(np.sin(theta) * point / adjusted), np.cos(theta)]


def covariance(document, direction):
    """Covariance (2, 2) of the projected pixel, px², with derivatives by differences."""
    u, field = document["uncertainty"], document["uncertainty"]["field"]
    p = np.hstack([document["model"][group] for group in GROUPS])
    steps = np.eye(23)[[NAMES.index(name) for name in u["parameters"]]]
    steps *= (1e-4 * np.sqrt(np.diag(u["covariance"])) + 1e-12)[:, None]
    rows = [(project(document, direction, p + h) - project(document, direction, p - h)) / (2 * h.sum()) for h in steps]
    rows = np.array(rows).T
    result = rows @ u["covariance"] @ rows.T
    if field["amplitude_px"] > 0:
        phi, a = waves(field, project(document, direction)), field["amplitude_px"]
        mixed = rows @ (np.array(field["cross"]) @ phi).T
        coupled = (
            np.array(field["coupling"]).reshape(2, -1, phi.size) @ phi
        )  # no rows where nothing is known of the field
        k = 0.5 * np.pi * np.array(field["orders"]) / field["half_px"] * field["length_px"]
        own = 2 * np.pi * field["length_px"] ** 2 * np.exp(-0.5 * np.sum(k**2, axis=1)) @ phi**2
        reduction = sum((np.array(row) @ phi) ** 2 for row in field["known"]) / own if own > 0 else 0
        unknown = max(a**2 - reduction, (0.02 * a) ** 2)
        result += mixed + mixed.T + coupled @ coupled.T + unknown * np.eye(2)
    return result.ravel()


def holding(document, given):
    """Distance, in stated sigmas, within which a share (the third number) of the errors at a pixel lies."""
    mixture, t = document["uncertainty"].get("mixture"), 0.0
    w, s = np.ones(1), np.ones(1)
    if mixture:
        near = (1 + np.sum((np.array(mixture["pixels_px"]) - given[:2]) ** 2, axis=1)) ** -2.0
        w, s = np.array(mixture["shares"]), near @ mixture["scales"] / near.sum()
    for _ in range(60):  # Newton's method; what is outside falls with t and is convex
        outside = w * np.exp(-t / (2 * s**2))
        t += outside.sum() * np.log(outside.sum() / (1 - given[2])) / np.sum(outside / (2 * s**2))
    return np.sqrt([t])


if __name__ == "__main__":
    content = json.loads(Path(sys.argv[1]).read_text("utf-8"))
    print(*globals()[sys.argv[2].replace("-", "_")](content, np.array([float(n) for n in sys.argv[3:]])))
