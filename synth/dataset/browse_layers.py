"""Labels of one image in, the layers of its tile out: pictures and drawings on top of each other in one SVG.

Layers that replace each other (image, depth, normals, flow) carry the class `base`, those that lie on top (parts,
amodal outlines, boxes, keypoints) the class `over`; the page's style sheet shows and hides them.
"""

import base64
import colorsys
import html
from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from ..labels.labelled import HIDDEN, SEEN, UNSEEN
from ..labels.solids import KEYPOINTS
from .coco import BONES
from .decode import Decoded

_GOLDEN = 0.61803398875
_WORDS = {UNSEEN: "not in the image", HIDDEN: "hidden", SEEN: "seen"}


def layers(image: Decoded, picture: tuple[str, bytes]) -> str:
    """One image with all its layers as an SVG.

    Parameters
    ----------
    picture : (str, bytes)
        Extension and content of the colour image, which is shown as it was stored.
    """
    height, width = image.image.shape[:2]
    kind = "png" if picture[0].endswith("png") else "jpeg"
    bases = [_image("image", kind, picture[1], width, height)]
    if image.depth is not None:
        bases.append(_image("depth", "jpeg", _jpeg(depth_colours(image.depth)), width, height))
    if image.normal is not None:
        bases.append(_image("normal", "jpeg", _jpeg(normal_colours(image.normal)), width, height))
    if image.flow is not None:
        bases.append(_image("flow", "jpeg", _jpeg(flow_colours(image.flow)), width, height))
    overs = []
    if image.part is not None:
        overs.append(_image("part", "png", _png(part_colours(image)), width, height))
    if image.amodal is not None:
        overs.append(f'<g class="over amodal">{_outlines(image)}</g>')
    overs += [f'<g class="over box">{_boxes(image)}</g>', f'<g class="over point">{_points(image)}</g>']
    return f'<svg viewBox="-0.5 -0.5 {width} {height}" role="img">{"".join(bases + overs)}</svg>'


def part_colour(part: int) -> tuple[int, int, int]:
    """Red, green, blue of a part; neighbours in number are far apart in hue.

    >>> part_colour(0)
    (242, 85, 85)
    """
    r, g, b = colorsys.hsv_to_rgb(part * _GOLDEN % 1.0, 0.65, 0.95)
    return round(255 * r), round(255 * g), round(255 * b)


def part_colours(image: Decoded) -> UInt8[np.ndarray, "h w 4"]:
    """Parts as colours that are half transparent, the background clear; red first."""
    count = len(image.parts.name)
    table = np.zeros((count + 1, 4), np.uint8)  # the last row is the background's: number -1
    for k in range(count):
        table[k] = *part_colour(k), 150
    return table[image.part]


def depth_colours(depth: Float[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w 3"]:
    """Depth from near (warm) to far (cold), the background black."""
    seen = np.isfinite(depth)
    if not seen.any():
        return np.zeros((*depth.shape, 3), np.uint8)
    low, high = depth[seen].min(), depth[seen].max()
    grey = np.where(seen, 235 - 215 * (np.where(seen, depth, low) - low) / max(high - low, 1e-6), 0)
    return cv2.applyColorMap(grey.astype(np.uint8), cv2.COLORMAP_TURBO)[..., ::-1] * seen[..., None].astype(np.uint8)


def normal_colours(normal: Float[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """Normals as colours, red to the right, green down, blue away; the background black."""
    seen = normal.any(axis=-1, keepdims=True)
    return (np.rint(127.5 * (normal + 1.0)) * seen).astype(np.uint8)


def flow_colours(flow: Float[np.ndarray, "h w 2"]) -> UInt8[np.ndarray, "h w 3"]:
    """Flow as hue (direction) and brightness (length against the longest)."""
    flow = np.nan_to_num(flow)
    length = np.hypot(flow[..., 0], flow[..., 1])
    hue = np.degrees(np.arctan2(flow[..., 1], flow[..., 0])) % 360.0 / 2.0
    value = 255.0 * length / max(float(length.max(initial=0.0)), 1e-6)
    hsv = np.dstack([hue, np.full_like(hue, 220.0), value]).astype(np.uint8)
    return cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)


def facts(image: Decoded) -> str:
    """What the image's JSON file says, as tables: keypoints and what hides them, parts, joint angles."""
    out = []
    for hand in range(image.keypoint.shape[0]):
        marks = zip(KEYPOINTS, image.visibility[hand].tolist(), image.hidden_by[hand].tolist(), strict=True)
        rows = [(name, _WORDS[seen] + (f" by {part_name(image, by)}" if by >= 0 else "")) for name, seen, by in marks]
        out.append(_table(f"{image.parts.kind[hand].replace('_', ' ')}: keypoints", rows))
        degrees = np.degrees(image.angles[hand])
        angles = [(name, f"{value:.1f}°") for name, value in zip(image.joint_names[hand], degrees, strict=True)]
        out.append(_table("joint angles", angles))
    shares = [
        (part_name(image, k), "outside" if share != share else f"{100 * share:.0f} % visible")
        for k, share in enumerate(image.fraction.tolist())
    ]
    return "".join([*out, _table("parts", shares)])


def part_name(image: Decoded, part: int) -> str:
    """Name of a part with that of its instance, where there are several hands."""
    instance = int(image.parts.instance[part])
    kind = image.parts.kind[instance]
    if not kind.endswith("hand"):
        return f"{kind} {instance}"
    side = kind.partition("_")[0] + " " if image.keypoint.shape[0] > 1 else ""
    return f"{side}{image.parts.name[part].replace('_', ' ')}"


def _table(caption: str, rows: Sequence[tuple[str, str]]) -> str:
    body = "".join(f"<tr><th>{html.escape(a)}</th><td>{html.escape(b)}</td></tr>" for a, b in rows)
    return f"<table><caption>{html.escape(caption)}</caption>{body}</table>"


def _image(name: str, kind: str, content: bytes, width: int, height: int) -> str:
    data = base64.b64encode(content).decode("ascii")
    role = "over" if name == "part" else "base"
    place = f'x="-0.5" y="-0.5" width="{width}" height="{height}"'
    return f'<image class="{role} {name}" {place} href="data:image/{kind};base64,{data}"/>'


def _jpeg(pixels: UInt8[np.ndarray, "h w 3"]) -> bytes:
    return cv2.imencode(".jpg", np.ascontiguousarray(pixels[..., ::-1]), (cv2.IMWRITE_JPEG_QUALITY, 85))[1].tobytes()


def _png(pixels: UInt8[np.ndarray, "h w 4"]) -> bytes:
    return cv2.imencode(".png", cv2.cvtColor(pixels, cv2.COLOR_RGBA2BGRA), (cv2.IMWRITE_PNG_COMPRESSION, 9))[
        1
    ].tobytes()


def _outlines(image: Decoded) -> str:
    """Outlines of the amodal masks, each in the colour of its part."""
    if image.amodal is None:
        return ""
    out = []
    for k in range(len(image.parts.name)):
        mask = (image.amodal >> np.uint64(k) & np.uint64(1)).astype(np.uint8)
        curves, _ = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
        path = "".join(
            "M" + "L".join(f"{x} {y}" for x, y in np.reshape(curve, (-1, 2)).tolist()) + "Z" for curve in curves
        )
        if path:
            title = html.escape(part_name(image, k))
            out.append(f'<path d="{path}" stroke="{_css(part_colour(k))}"><title>{title}</title></path>')
    return "".join(out)


def _boxes(image: Decoded) -> str:
    """Boxes of instances: solid around what is seen, dashed around the whole."""
    out = []
    for style, boxes in (("modal", image.modal_box), ("whole", image.amodal_box)):
        for kind, (x0, y0, x1, y1) in zip(image.parts.kind, boxes.tolist(), strict=True):
            if x1 > x0:
                place = f'x="{x0 - 0.5:g}" y="{y0 - 0.5:g}" width="{x1 - x0:g}" height="{y1 - y0:g}"'
                out.append(f'<rect class="{style}" {place}><title>{kind.replace("_", " ")}</title></rect>')
    return "".join(out)


def _points(image: Decoded) -> str:
    """Bones, and keypoints coloured by visibility; a hidden one is filled with the colour of the part that hides it."""
    out = []
    radius = max(image.image.shape[:2]) / 110
    for hand in range(image.keypoint.shape[0]):
        xy, visible = image.keypoint[hand], image.visibility[hand]
        known = np.isfinite(xy).all(axis=1)
        for a, b in BONES:
            if known[a] and known[b]:
                (x0, y0), (x1, y1) = xy[[a, b]].tolist()
                out.append(f'<line x1="{x0:.2f}" y1="{y0:.2f}" x2="{x1:.2f}" y2="{y1:.2f}"/>')
        for k in np.flatnonzero(visible > UNSEEN).tolist():
            by = int(image.hidden_by[hand, k])
            says = f"{KEYPOINTS[k].replace('_', ' ')}: {_WORDS[int(visible[k])]}"
            style, fill = ("seen", "") if by < 0 else ("hidden", f' fill="{_css(part_colour(by))}"')
            says += f" by {part_name(image, by)}" if by >= 0 else ""
            place = f'cx="{xy[k, 0]:.2f}" cy="{xy[k, 1]:.2f}" r="{radius:.2f}"'
            out.append(f'<circle class="{style}"{fill} {place}><title>{html.escape(says)}</title></circle>')
    return "".join(out)


def _css(colour: tuple[int, int, int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)
