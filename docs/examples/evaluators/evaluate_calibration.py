"""Evaluates a calibration document (docs/model.md) with numpy alone.

python evaluate_calibration.py calibration.json project EAST NORTH UP      prints x y, px
python evaluate_calibration.py calibration.json back-project X Y           prints east north up
python evaluate_calibration.py calibration.json covariance EAST NORTH UP   prints xx xy yx yy of the pixel, px squared
"""

import copy
import json
import sys

import numpy as np

IDEAL = {
    "perspective": (np.tan, np.arctan),
    "equidistant": (lambda t: t, lambda r: r),
    "equisolid": (lambda t: 2 * np.sin(t / 2), lambda r: 2 * np.arcsin(r / 2)),
    "stereographic": (lambda t: 2 * np.tan(t / 2), lambda r: 2 * np.arctan(r / 2)),
    "orthographic": (np.sin, np.arcsin),
}
PLACES = {"skew_px": ("skew_px", None)} | {
    name: (group, index)
    for group, names in {
        "focal_length_px": "focal_length_x_px focal_length_y_px",
        "principal_point_px": "principal_point_x_px principal_point_y_px",
        "rotation_cam_enu": "rotation_x rotation_y rotation_z",
        "translation": "translation_x translation_y translation_z",
        "radial": "k2 k3 k4 k5 k6 k7 k8 k9",
        "decentering": "p1 p2 p3 p4",
    }.items()
    for index, name in enumerate(names.split())
}


def rotation(w):
    """Matrix of a rotation vector, east-north-up to camera (Rodrigues)."""
    angle = np.linalg.norm(w)
    a = np.cross(np.eye(3), np.array(w) / (angle or 1.0))
    return np.eye(3) + np.sin(angle) * a + (1 - np.cos(angle)) * a @ a


def shift(c, r, x, y):
    """Decentering in focal lengths at radius r, direction (x, y) / r; c = p1 … p4 or q1 … q5."""
    u, v = (x / r, y / r) if r > 0 else (1.0, 0.0)
    g = r**2 * (1 + sum(k * r ** (2 * n) for n, k in enumerate(c[2:], 1)))
    return g * (c[0] * (1 + 2 * u * u) + 2 * c[1] * u * v), g * (2 * c[0] * u * v + c[1] * (1 + 2 * v * v))


def project(document, direction):
    """Pixel x, y of a unit vector, east-north-up; NaN beyond max_angle_deg."""
    m, image = document["model"], document["image"]
    x, y, z = rotation(m["rotation_cam_enu"]) @ direction + m["translation"]
    theta, across = np.arctan2(np.hypot(x, y), z), np.hypot(x, y)
    if theta > np.radians(m["max_angle_deg"]):
        return np.array([np.nan, np.nan])
    tau = theta / (np.pi / 2)
    r = IDEAL[m["projection"]][0](theta) + sum(k * tau**n for n, k in enumerate(m["radial"], 2))
    x, y = (r * x / across, r * y / across) if across > 0 else (0.0, 0.0)
    dx, dy = shift(m["decentering"], r, x, y)
    (fx, fy), (x0, y0) = m["focal_length_px"], m["principal_point_px"]
    px, py = fx * (x + dx) + m["skew_px"] * (y + dy) + x0, fy * (y + dy) + y0
    return np.array([image["width"] - 1 - px if image["mirrored"] else px, py])


def back_project(document, pixel):
    """Unit vector, east-north-up, of a pixel by the closed form; off by up to backward_model.max_error_px."""
    m, b, image = document["model"], document["backward_model"], document["image"]
    px = image["width"] - 1 - pixel[0] if image["mirrored"] else pixel[0]
    y = (pixel[1] - m["principal_point_px"][1]) / m["focal_length_px"][1]
    x = (px - m["principal_point_px"][0] - m["skew_px"] * y) / m["focal_length_px"][0]
    r = np.hypot(x, y)
    dx, dy = shift(b["decentering"], r, x, y)
    x, y = x - dx, y - dy
    adjusted = np.hypot(x, y) or 1.0
    scale = 1 - sum(k * r**n for n, k in enumerate(b["radial"], 2)) / adjusted
    theta = IDEAL[m["projection"]][1](adjusted * scale)
    ray = np.sin(theta) * x / adjusted, np.sin(theta) * y / adjusted, np.cos(theta)
    return rotation(m["rotation_cam_enu"]).T @ ray


def covariance(document, direction):
    """Covariance (2, 2) of the projected pixel, px², with derivatives by differences."""
    u, field = document["uncertainty"], document["uncertainty"]["field"]
    size = np.sqrt(np.diag(u["covariance"]))

    def moved(k, step):
        changed = copy.deepcopy(document)
        group, index = PLACES[u["parameters"][k]]
        value = changed["model"][group]
        changed["model"][group] = (
            value + step if index is None else [*value[:index], value[index] + step, *value[index + 1 :]]
        )
        return project(changed, direction)

    steps = 1e-4 * size + 1e-12
    rows = np.stack([(moved(k, h) - moved(k, -h)) / (2 * h) for k, h in enumerate(steps)], axis=1)
    result = rows @ u["covariance"] @ rows.T
    if field["amplitude_px"] > 0:
        place = np.array(field["orders"]) * (project(document, direction) - field["center_px"] + field["half_px"])
        waves = np.prod(np.sin(0.5 * np.pi * place / field["half_px"]) / np.sqrt(field["half_px"]), axis=1)
        mixed = rows @ np.stack([np.array(cross) @ waves for cross in field["cross"]], axis=1)
        result += mixed + mixed.T + field["amplitude_px"] ** 2 * np.eye(2)
    return result.ravel()


COMMANDS = {"project": project, "back-project": back_project, "covariance": covariance}

if __name__ == "__main__":
    numbers = np.array([float(n) for n in sys.argv[3:]])
    with open(sys.argv[1], encoding="utf-8") as file:
        print(*COMMANDS[sys.argv[2]](json.load(file), numbers))
