"use strict";
// A person in a room: metres, world axes (z up), drawn on a plain canvas; from above if `plan`.
const bytesOf = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;

const vec = {
  sub: (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]],
  add: (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]],
  dot: (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2],
  cross: (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]],
  unit: (a) => { const n = Math.hypot(...a) || 1; return [a[0] / n, a[1] / n, a[2] / n]; },
};

// What the page was given, by frame; null where there is nothing.
const makeWorld = (data) => {
  const floats = (text) => new Float32Array(bytesOf(text));
  const rows = (text, d) => { const all = floats(text); return (i) => { const row = all.subarray(d * i, d * i + d); return row.some(Number.isNaN) ? null : [...row]; }; };
  const one = (text) => { const all = floats(text); return (i) => (Number.isNaN(all[i]) ? null : all[i]); };
  const keys = data.keypoints.length, joints = data.joints.length;
  const body = (of) => { const points = rows(of.points, 3); return { pelvis: rows(of.pelvis, 3), heading: one(of.heading), point: (n, k) => points(n * keys + k) }; };
  const seen = data.seen && rows(data.seen, 2), status = new Uint8Array(bytesOf(data.status)), inView = new Uint8Array(bytesOf(data.inView));
  const posture = one(data.posture), spread = one(data.sigmaPosture);
  return {
    data, keys, count: data.time.length,
    ours: body(data), raw: data.raw && body(data.raw), truth: data.truth && body(data.truth),
    sigma: rows(data.sigma, 3), sigmaHeading: one(data.sigmaHeading),
    joint: (n, j) => posture(n * joints + j), sigmaJoint: (n, j) => spread(n * joints + j),
    seen: (n, k) => (seen ? seen(n * keys + k) : null),
    status: (n) => status[n], blind: (n) => !inView[n],
  };
};

const makeScene = (canvas, world, plan) => {
  const { data, ours, raw, truth } = world, pen = canvas.getContext("2d"), cam = data.camera;
  const apply = (R, v) => R.map((row) => vec.dot(row, v)), turned = (R, v) => [0, 1, 2].map((j) => R[0][j] * v[0] + R[1][j] * v[1] + R[2][j] * v[2]);
  const eyeAt = cam && turned(cam.R, cam.t).map((v) => -v);
  const intoRoom = (p) => turned(cam.R, vec.sub(p, cam.t));

  // Where the person goes, robustly: what the views look at.
  const bounds = (of) => [0, 1].map((i) => {
    const v = [];
    for (const each of of) if (each) for (let n = 0; n < world.count; n++) { const p = each.pelvis(n); if (p) v.push(p[i]); }
    v.sort((a, b) => a - b);
    return v.length ? [v[Math.floor(0.005 * v.length)], v[Math.min(v.length - 1, Math.floor(0.995 * v.length))]] : [-1, 1];
  });
  const own = bounds([ours, truth]), wide = bounds([ours, truth, raw]);
  const middle = [(own[0][0] + own[0][1]) / 2, (own[1][0] + own[1][1]) / 2, 0.9];
  const size = Math.max(1, Math.hypot(own[0][1] - own[0][0], own[1][1] - own[1][0]));
  const seat = eyeAt ? Math.atan2(eyeAt[1] - middle[1], eyeAt[0] - middle[0]) : -Math.PI / 2; // look from the camera's side
  const home = (name) => {
    if (name === "camera") return { camera: true };
    if (name === "follow") return { follow: true, target: middle, yaw: seat + 0.5, pitch: 0.15, half: 1.25 };
    return { target: [middle[0], middle[1], 0.75], yaw: seat + 0.45, pitch: 0.42, half: Math.max(1.3, 0.42 * size + 0.7) };
  };
  let eye = home("side");

  const colour = {};
  const read = () => {
    const style = getComputedStyle(document.documentElement);
    for (const name of ["c0", "c1", "c2", "tracked", "predicted", "uncertain", "lost", "truth", "soft", "grid", "zero", "ink", "card", "neutral", "raw"]) colour[name] = style.getPropertyValue(`--${name}`).trim();
  };

  let width = 1, height = 1, through = null;
  // A view: place to pixels (null behind it), and the pixels' derivative for ellipses.
  const projection = (frame) => {
    if (plan) {
      const box = wide.map(([a, b]) => [a - 0.45, b + 0.45]), near = eyeAt && Math.hypot(eyeAt[0] - middle[0], eyeAt[1] - middle[1]) < 2 * size + 3;
      if (near) [0, 1].forEach((i) => { box[i] = [Math.min(box[i][0], eyeAt[i] - 0.3), Math.max(box[i][1], eyeAt[i] + 0.3)]; });
      // The longer side of the room goes along the longer side of the picture.
      const lying = (box[0][1] - box[0][0] >= box[1][1] - box[1][0]) === width >= height, right = lying ? [1, 0, 0] : [0, 1, 0], top = lying ? [0, 1, 0] : [-1, 0, 0];
      const across = lying ? box[0] : box[1], along = lying ? box[1] : [-box[0][1], -box[0][0]];
      const s = Math.min(width / (across[1] - across[0]), height / (along[1] - along[0])), x0 = width / 2 - (s * (across[0] + across[1])) / 2, y0 = height / 2 + (s * (along[0] + along[1])) / 2;
      return { box, scale: s, lying, at: (p) => [x0 + s * vec.dot(p, right), y0 - s * vec.dot(p, top)], jacobian: () => [right.map((v) => v * s), top.map((v) => -v * s)] };
    }
    if (eye.camera && cam) {
      const s = Math.min(width / cam.width, height / cam.height), x0 = (width - s * cam.width) / 2, y0 = (height - s * cam.height) / 2;
      const pixel = (u, v) => [x0 + s * (u + 0.5), y0 + s * (v + 0.5)];
      return {
        frame: [x0, y0, s * cam.width, s * cam.height], scale: (s * cam.fx) / 4, pixel,
        at: (p) => { const q = vec.add(apply(cam.R, p), cam.t); return q[2] < 0.05 ? null : pixel((cam.fx * q[0]) / q[2] + cam.cx, (cam.fy * q[1]) / q[2] + cam.cy); },
        jacobian: (p) => {
          const q = vec.add(apply(cam.R, p), cam.t), z = q[2];
          return [turned(cam.R, [(s * cam.fx) / z, 0, (-s * cam.fx * q[0]) / z ** 2]), turned(cam.R, [0, (s * cam.fy) / z, (-s * cam.fy * q[1]) / z ** 2])];
        },
      };
    }
    if (eye.follow) { const p = ours.pelvis(frame); if (p) eye.target = [p[0], p[1], 0.9]; }
    const level = [Math.cos(eye.yaw), Math.sin(eye.yaw), 0], back = [level[0] * Math.cos(eye.pitch), level[1] * Math.cos(eye.pitch), Math.sin(eye.pitch)];
    const right = vec.cross([0, 0, 1], level), top = vec.cross(back, right), s = height / (2 * eye.half);
    return {
      right, top, scale: s,
      at: (p) => { const q = vec.sub(p, eye.target); return [width / 2 + s * vec.dot(q, right), height / 2 - s * vec.dot(q, top)]; },
      jacobian: () => [right.map((v) => v * s), top.map((v) => -v * s)],
    };
  };

  const path = (points, style, thick, dash = [], alpha = 1) => {
    pen.strokeStyle = style; pen.lineWidth = thick; pen.setLineDash(dash); pen.globalAlpha = alpha;
    pen.beginPath();
    let open = false;
    for (const p of points) {
      const q = p && through.at(p);
      if (q) { if (open) pen.lineTo(...q); else pen.moveTo(...q); }
      open = !!q;
    }
    pen.stroke();
    pen.setLineDash([]); pen.globalAlpha = 1;
  };
  const spot = (q, r, fill, stroke, alpha = 1) => {
    if (!q) return;
    pen.globalAlpha = alpha;
    pen.beginPath(); pen.arc(...q, r, 0, 2 * Math.PI);
    if (fill) { pen.fillStyle = fill; pen.fill(); }
    if (stroke) { pen.strokeStyle = stroke; pen.lineWidth = 1.8; pen.stroke(); }
    pen.globalAlpha = 1;
  };
  const dot = (p, ...more) => spot(p && through.at(p), ...more);
  // The shadow of the ellipsoid x' C^-1 x = 4 has the axes of J C J'; C is diagonal.
  const ellipse = (p, sigma, style, strong) => {
    const q = p && sigma && through.at(p);
    if (!q) return;
    const [a, b] = through.jacobian(p), times = (v) => v.map((x, i) => x * sigma[i] ** 2);
    const xx = vec.dot(a, times(a)), xy = vec.dot(a, times(b)), yy = vec.dot(b, times(b));
    const mean = (xx + yy) / 2, off = Math.hypot((xx - yy) / 2, xy), turn = 0.5 * Math.atan2(2 * xy, xx - yy);
    pen.beginPath();
    pen.ellipse(...q, 2 * Math.sqrt(Math.max(mean + off, 0.01)), 2 * Math.sqrt(Math.max(mean - off, 0.01)), turn, 0, 2 * Math.PI);
    pen.globalAlpha = strong ? 0.2 : 0.07; pen.fillStyle = style; pen.fill();
    pen.globalAlpha = strong ? 0.95 : 0.5; pen.strokeStyle = style; pen.lineWidth = strong ? 1.8 : 1; pen.stroke();
    pen.globalAlpha = 1;
  };

  const ground = () => {
    const step = 0.5, box = plan ? through.box.map(([a, b]) => [a - 6, b + 6]) : own.map(([a, b]) => [a - 1.2, b + 1.2]);
    const [[x0, x1], [y0, y1]] = box.map(([a, b]) => [Math.floor(a / step) * step, Math.ceil(b / step) * step]);
    for (let x = x0; x <= x1 + 1e-6; x += step) path([[x, y0, 0], [x, y1, 0]], colour.zero, 1, [], 0.35);
    for (let y = y0; y <= y1 + 1e-6; y += step) path([[x0, y, 0], [x1, y, 0]], colour.zero, 1, [], 0.35);
  };
  const wedge = () => {
    if (!cam || through.frame) return;
    const d = plan ? 0.3 : 0.28, edge = [[0, 0], [cam.width, 0], [cam.width, cam.height], [0, cam.height]].map(([u, v]) => intoRoom([(d * (u - cam.cx)) / cam.fx, (d * (v - cam.cy)) / cam.fy, d]));
    edge.forEach((p, k) => path([eyeAt, p, edge[(k + 1) % 4]], colour.soft, 1.3));
    if (plan) for (const u of [0, cam.width]) path([eyeAt, intoRoom([(12 * (u - cam.cx)) / cam.fx, 0, 12])], colour.soft, 1, [2, 5], 0.7);
    else path([eyeAt, [eyeAt[0], eyeAt[1], 0]], colour.soft, 1, [2, 4], 0.6);
  };
  const words = (text, at, style) => {
    pen.font = "600 12.5px system-ui, sans-serif";
    pen.lineWidth = 3.5; pen.strokeStyle = colour.card; pen.lineJoin = "round";
    pen.strokeText(text, ...at);
    pen.fillStyle = style; pen.fillText(text, ...at);
  };
  const flat = (p) => p && (plan || through.frame ? (plan ? p : [p[0], p[1], 0]) : [p[0], p[1], 0]);
  // A path from one frame to another, dotted while out of view.
  const track = (of, style, thick, first, last, alpha, dotted) => {
    const parts = { seen: [], blind: [] };
    let before = null;
    for (let n = first; n <= last; n++) {
      const q = flat(of.pelvis(n)), name = dotted && q && world.blind(n) ? "blind" : "seen";
      for (const each of ["seen", "blind"]) parts[each].push(each === name ? q : null);
      if (q && before && before.name !== name) parts[name].splice(-1, 1, before.q, q);
      before = q && { q, name };
    }
    path(parts.seen, style, thick, [], alpha);
    path(parts.blind, style, thick, [1.5, 4.5], alpha);
  };
  const bones = (of, n, style, thick, alpha, dash = []) => { for (const [a, b] of data.bones) { const p = of.point(n, a), q = of.point(n, b); if (p && q) path([p, q], style, thick, dash, alpha); } };
  const arrow = (of, n, style, length) => {
    const p = of.pelvis(n), turn = of.heading(n);
    if (!p || turn === null) return;
    const a = (turn * Math.PI) / 180, tip = [p[0] + length * Math.cos(a), p[1] + length * Math.sin(a), p[2]];
    path([flat(p), flat(tip)], style, 2.4);
    const side = (s) => flat([tip[0] - 0.1 * Math.cos(a + s), tip[1] - 0.1 * Math.sin(a + s), p[2]]);
    path([side(0.5), flat(tip), side(-0.5)], style, 2.4);
  };

  let shown = null;
  const above = (frame, layers, trail) => {
    const first = trail === null ? 0 : data.time.findIndex((t) => t >= data.time[frame] - trail), last = trail === null ? world.count - 1 : frame;
    if (trail !== null) track(ours, colour.c0, 1, 0, world.count - 1, 0.12, false);
    if (layers.truth && truth) track(truth, colour.truth, 1.4, first, last, trail === null ? 0.5 : 0.75, false);
    if (layers.raw && raw) track(raw, colour.raw, 1.5, first, last, trail === null ? 0.45 : 0.85, true);
    track(ours, colour.c0, 2.2, first, last, trail === null ? 0.55 : 0.95, true);
    if (layers.ellipses) {
      const apart = trail === null ? (data.time[last] - data.time[first]) / 120 : trail / 14;
      let next = -Infinity;
      for (let n = first; n < last; n++) if (data.time[n] >= next) { ellipse(ours.pelvis(n), world.sigma(n), world.blind(n) ? colour.predicted : colour.c0, false); next = data.time[n] + Math.max(apart, 0.4); }
      ellipse(ours.pelvis(frame), world.sigma(frame), world.blind(frame) ? colour.predicted : colour.c0, true);
    }
    if (layers.raw && raw) { arrow(raw, frame, colour.raw, 0.3); dot(raw.pelvis(frame), 4.5, colour.card, colour.raw); }
    if (layers.truth && truth) { arrow(truth, frame, colour.truth, 0.3); dot(truth.pelvis(frame), 4.5, colour.card, colour.truth); }
    arrow(ours, frame, colour.c0, 0.38);
    dot(ours.pelvis(frame), 5.5, colour.c0, colour.card);
    pen.globalAlpha = 0.9;
    words(through.lying ? "x \u2192" : "y \u2192", [10, height - 10], colour.soft);
    words(through.lying ? "\u2191 y" : "\u2193 x", [42, height - 10], colour.soft);
    pen.globalAlpha = 1;
  };
  const room = (frame, layers) => {
    const thick = Math.max(2.2, Math.min(7, 0.03 * through.scale)), first = data.time.findIndex((t) => t >= data.time[frame] - 10);
    if (!through.frame) {
      track(ours, colour.c0, 1.6, first, frame, 0.7, true);
      if (layers.ellipses) { const p = ours.pelvis(frame); ellipse(p && [p[0], p[1], 0], world.sigma(frame), colour.c0, true); }
    }
    if (layers.raw && raw) bones(raw, frame, colour.raw, Math.max(1.6, 0.45 * thick), 0.8);
    if (layers.truth && truth) bones(truth, frame, colour.truth, Math.max(1.2, 0.3 * thick), 0.8);
    const style = world.blind(frame) ? colour.predicted : colour.c0;
    bones(ours, frame, style, thick, 0.92, world.status(frame) ? [thick * 1.3, thick * 1.4] : []);
    for (let k = 0; k < 12; k++) dot(ours.point(frame, k), thick * 0.95, style, colour.card);
    const top = ours.point(frame, 15);
    if (top) dot(vec.add(top, [0, 0, 0.04]), Math.max(4, 0.1 * through.scale * 0.9), style, colour.card, 0.9);
    if (layers.ellipses) ellipse(ours.pelvis(frame), world.sigma(frame), style, true);
    if (!through.frame) arrow(ours, frame, style, 0.4);
    else if (layers.seen) for (let k = 0; k < world.keys; k++) { const uv = world.seen(frame, k); if (uv) spot(through.pixel(...uv), 3.6, colour.c1, colour.card); }
  };
  const show = (frame, layers, trail) => {
    const ratio = Math.min(devicePixelRatio || 1, 2);
    width = canvas.clientWidth; height = canvas.clientHeight;
    if (!width || !height) return;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) { canvas.width = Math.round(width * ratio); canvas.height = Math.round(height * ratio); }
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    through = projection(frame);
    shown = { frame, trail };
    pen.lineCap = "round"; pen.lineJoin = "round";
    if (through.frame) { pen.save(); pen.beginPath(); pen.rect(...through.frame); pen.fillStyle = colour.card; pen.fill(); pen.clip(); }
    ground();
    wedge();
    if (plan) above(frame, layers, trail);
    else room(frame, layers);
    if (through.frame) { pen.restore(); pen.strokeStyle = colour.zero; pen.lineWidth = 1; pen.strokeRect(...through.frame); }
  };

  // The frame whose place is nearest to a spot of the plan, of those that are shown, or of all if none of these is near.
  const pick = (x, y) => {
    const nearest = (first, last) => {
      let best = { d: Infinity, n: null };
      for (let n = first; n <= last; n++) { const p = ours.pelvis(n), q = p && through.at(p), d = q ? Math.hypot(q[0] - x, q[1] - y) : Infinity; if (d < best.d) best = { d, n }; }
      return best;
    };
    if (!shown) return null;
    const { frame, trail } = shown, few = trail === null ? nearest(0, world.count - 1) : nearest(data.time.findIndex((t) => t >= data.time[frame] - trail), frame);
    if (few.d < 16) return few.n;
    const all = nearest(0, world.count - 1);
    return all.d < 16 ? all.n : null;
  };
  const turn = (dx, dy) => { if (eye.camera) return; eye.yaw -= dx * 0.008; eye.pitch = Math.max(-0.2, Math.min(1.5, eye.pitch + dy * 0.008)); };
  const move = (dx, dy) => { if (eye.camera || !through) return; eye.follow = false; eye.target = vec.add(vec.add(eye.target, through.right, -dx / through.scale), through.top, dy / through.scale); };
  const zoom = (by) => { if (!eye.camera) eye.half = Math.max(0.15, Math.min(20, eye.half * Math.exp(by))); };
  read();
  return { show, pick, turn, move, zoom, read, from: (view) => { eye = home(view); } };
};
