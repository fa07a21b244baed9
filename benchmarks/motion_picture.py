"""A picture of speed, acceleration and jerk along a few strokes: `python -m benchmarks motion_picture` writes it to out/."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from benchmarks.motion import KINEMATICS, LIMIT_SETS, strokes
from planning.geometry.stroke import Stroke
from planning.motion.draw import draw_motions
from planning.motion.limits import Limits
from planning.motion.plan import Motion

SHOWN = ("square20", "cursive", "text15", "hatch_rect")
LONGEST_S = 1.8
WIDTH, HEIGHT, MARGIN, PATH_WIDTH = 1080, 240, 20, 350
RED, BLUE, GREY = (220, 40, 20), (40, 90, 200), (190, 190, 190)
OUT = Path("out") / "motion-speed.png"


def run() -> None:
    limits = LIMIT_SETS["L2"]
    group = strokes()
    picture = Image.new("RGB", (WIDTH + PATH_WIDTH + 3 * MARGIN, len(SHOWN) * (HEIGHT + 2 * MARGIN) + MARGIN), "white")
    draw = ImageDraw.Draw(picture)
    for k, name in enumerate(SHOWN):
        longest = max(map(Stroke, group[name]), key=lambda stroke: stroke.length_mm)
        (motion,) = draw_motions([longest], limits, KINEMATICS)
        top = MARGIN + k * (HEIGHT + 2 * MARGIN)
        _row(draw, name, motion, limits, top)
    OUT.parent.mkdir(exist_ok=True)
    picture.save(OUT)
    print(OUT)


def _row(draw: ImageDraw.ImageDraw, name: str, motion: Motion, limits: Limits, top: int) -> None:
    end_s = min(motion.total_s, LONGEST_S)
    t = np.linspace(0.0, end_s, WIDTH)
    _, v, a, j = motion.sample(t)
    draw.text((MARGIN, top), f"{name}: red |v|/V, blue |a|/A, grey |j|/J over 0 to {end_s:.2f} s; right: the path, red = fast",
              fill="black", font=ImageFont.load_default(size=14))  # fmt: skip
    low = top + MARGIN + HEIGHT
    draw.rectangle((MARGIN, top + MARGIN, MARGIN + WIDTH, low), outline=(120, 120, 120))
    bounds = (limits.jerk_mm_s3, limits.acceleration_mm_s2, limits.speed_mm_s)
    for values, bound, colour in zip((j, a, v), bounds, (GREY, BLUE, RED), strict=True):
        share = np.hypot(*values.T) / bound
        draw.line([(MARGIN + x, low - HEIGHT * 0.97 * y) for x, y in enumerate(share.tolist())], fill=colour, width=2)
    whole = np.linspace(0.0, motion.total_s, 4 * WIDTH)
    points, speed, *_ = motion.sample(whole)
    size = np.ptp(points, axis=0).max()
    place = (points - points.min(axis=0)) * (min(PATH_WIDTH, HEIGHT) / size) + (2 * MARGIN + WIDTH, top + MARGIN)
    fast = np.hypot(*speed.T) / limits.speed_mm_s
    for p, q, f in zip(place[:-1].tolist(), place[1:].tolist(), fast.tolist(), strict=False):
        draw.line((*p, *q), fill=(int(230 * min(f, 1.0)), 20, int(230 * (1 - min(f, 1.0)))), width=2)
