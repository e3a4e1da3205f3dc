"use strict";
// People in space: metres, camera axes (x right, y down, z forward), drawn on a plain canvas.
const bytesOf = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
const NOWHERE = -32768, FILTERED = 12, LEVEL = Math.sqrt(7.814727903251179);

const vec = {
  sub: (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]],
  add: (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]],
  dot: (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2],
  cross: (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]],
  unit: (a) => { const n = Math.hypot(...a) || 1; return [a[0] / n, a[1] / n, a[2] / n]; },
};

// What the page was given, by frame, label and keypoint.
const makeWorld = (data) => {
  const keys = data.keypoints.length, count = data.time.length;
  const places = (text) => { const mm = new Int16Array(bytesOf(text)); return (row) => (mm[3 * row] === NOWHERE ? null : [mm[3 * row] / 1000, mm[3 * row + 1] / 1000, mm[3 * row + 2] / 1000]); };
  const table = (entries) => {
    const rows = new Map(data.labels.map((label) => [label, new Int32Array(count).fill(-1)]));
    for (let n = 0; n < count; n++) for (let i = entries.starts[n]; i < entries.starts[n + 1]; i++) if (rows.has(entries.label[i])) rows.get(entries.label[i])[n] = i;
    return { row: (label, n) => rows.get(label)[n], at: places(entries.p) };
  };
  const people = table(data.people), raw = data.raw && table(data.raw);
  const status = new Uint8Array(bytesOf(data.people.status)), spread = new Float32Array(bytesOf(data.people.covariance));
  const seen = places(data.seen.p), truth = data.truth && places(data.truth.p);
  const p = (label, n, k) => { const i = people.row(label, n); return i < 0 ? null : people.at(i * keys + k); };
  return {
    data, keys, count, p,
    here: (label, n) => people.row(label, n) >= 0,
    status: (label, n, k) => { const i = people.row(label, n); return i < 0 ? -1 : status[i * keys + k]; },
    covariance: (label, n, k) => { const i = people.row(label, n); return i < 0 ? null : spread.subarray(6 * (i * keys + k), 6 * (i * keys + k) + 6); },
    raw: (label, n, k) => { if (!raw) return null; const i = raw.row(label, n); return i < 0 ? null : raw.at(i * keys + k); },
    seen: (n) => { const out = []; for (let i = data.seen.starts[n]; i < data.seen.starts[n + 1]; i++) out.push((k) => seen(i * keys + k)); return out; },
    // Truth of the person for whom a label stands.
    truth: (label, n, k) => { if (!truth) return null; const who = data.truth.label.indexOf(label); return who < 0 ? null : truth((n * data.truth.label.length + who) * keys + k); },
    truths: (n) => (truth ? data.truth.label.map((_, who) => (k) => truth((n * data.truth.label.length + who) * keys + k)) : []),
    hips: (label, n) => { const a = p(label, n, 6), b = p(label, n, 7); return a && b ? [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2, (a[2] + b[2]) / 2] : p(label, n, 13) || p(label, n, 12) || a || b || p(label, n, 0) || p(label, n, 1); },
    blind: (label, n) => { for (let k = 0; k < FILTERED; k++) if (status[people.row(label, n) * keys + k] === 0) return false; return true; },
  };
};

const makeScene = (canvas, world, plan) => {
  const { data } = world, pen = canvas.getContext("2d");
  const up = data.up, forward = vec.unit(vec.sub([0, 0, 1], up.map((x) => x * up[2])));
  const aside = vec.cross(forward, up), floor = data.floor ?? -1.5;
  const onFloor = (p) => vec.add(p, up, floor - vec.dot(p, up));

  // Where everybody is, robustly: what the views look at.
  const spots = [[], [], []];
  for (const label of data.labels) for (let n = 0; n < world.count; n++) {
    const p = world.hips(label, n);
    if (p) [aside, up, forward].forEach((axis, i) => spots[i].push(vec.dot(p, axis)));
  }
  const bounds = spots.map((v) => { v.sort((a, b) => a - b); const at = (q) => (v.length ? v[Math.min(v.length - 1, Math.floor(q * v.length))] : q < 0.5 ? -0.5 : 0.5); return [at(0.02), at(0.98)]; });
  const compose = (a, b, c) => vec.add(vec.add(vec.add([0, 0, 0], aside, a), up, b), forward, c);
  const middle = compose((bounds[0][0] + bounds[0][1]) / 2, floor + 0.88, (bounds[2][0] + bounds[2][1]) / 2);
  const wide = Math.max(0.5, bounds[0][1] - bounds[0][0]), deep = Math.max(0.5, bounds[2][1] - bounds[2][0]);
  const home = (name) => {
    if (name === "camera") return { camera: true };
    if (name === "front") return { target: middle, yaw: 0, pitch: 0.06, half: Math.max(1.1, 0.42 * wide + 0.5) };
    return { target: middle, yaw: 0.72, pitch: 0.42, half: Math.max(1.2, 0.36 * Math.hypot(wide, deep) + 0.75) };
  };
  let eye = home("side");

  const colour = {};
  const read = () => {
    const style = getComputedStyle(document.documentElement);
    for (const name of ["c0", "c1", "c2", "c3", "c4", "c5", "seen", "predicted", "lost", "truth", "soft", "grid", "zero", "ink", "card", "neutral", "raw"]) colour[name] = style.getPropertyValue(`--${name}`).trim();
  };
  const ofLabel = (label) => colour[`c${data.labels.indexOf(label) % 6}`];

  let width = 1, height = 1, through = null;
  // A view: place to pixels (null behind it), and the pixels' derivative for ellipses.
  const projection = () => {
    if (plan) {
      const low = Math.min(0, bounds[2][0]) - 0.25, high = Math.max(bounds[2][1] + 0.6, Math.min(data.gate ?? 0, bounds[2][1] + 1.2) + 0.1), side = Math.max(-bounds[0][0], bounds[0][1]) + 0.6;
      const s = Math.min(height / (high - low), width / (2 * side));
      const x0 = width / 2, y0 = height / 2 + (s * (high + low)) / 2;
      return { at: (p) => [x0 + s * vec.dot(p, aside), y0 - s * vec.dot(p, forward)], jacobian: () => [aside.map((v) => v * s), forward.map((v) => -v * s)], scale: s };
    }
    if (eye.camera && data.camera) {
      const c = data.camera, s = Math.min(width / c.width, height / c.height), x0 = (width - s * c.width) / 2, y0 = (height - s * c.height) / 2;
      return {
        frame: [x0, y0, s * c.width, s * c.height], scale: (s * c.fx) / 2,
        at: (p) => (p[2] < 0.05 ? null : [x0 + s * ((c.fx * p[0]) / p[2] + c.cx + 0.5), y0 + s * ((c.fy * p[1]) / p[2] + c.cy + 0.5)]),
        jacobian: (p) => [[(s * c.fx) / p[2], 0, (-s * c.fx * p[0]) / p[2] ** 2], [0, (s * c.fy) / p[2], (-s * c.fy * p[1]) / p[2] ** 2]],
      };
    }
    const level = vec.add(aside.map((x) => x * Math.sin(eye.yaw)), forward, -Math.cos(eye.yaw));
    const back = vec.add(level.map((x) => x * Math.cos(eye.pitch)), up, Math.sin(eye.pitch));
    const right = vec.unit(vec.cross(up, level)), top = vec.cross(back, right), s = height / (2 * eye.half);
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
  const dot = (p, r, fill, stroke, alpha = 1) => {
    const q = p && through.at(p);
    if (!q) return;
    pen.globalAlpha = alpha;
    pen.beginPath(); pen.arc(...q, r, 0, 2 * Math.PI);
    if (fill) { pen.fillStyle = fill; pen.fill(); }
    if (stroke) { pen.strokeStyle = stroke; pen.lineWidth = 1.8; pen.stroke(); }
    pen.globalAlpha = 1;
  };
  // The shadow of the ellipsoid x' C^-1 x = 7.815 has the axes of J C J'.
  const ellipse = (p, c, style, strong) => {
    const q = through.at(p);
    if (!q || !c) return;
    const C = [[c[0], c[1], c[2]], [c[1], c[3], c[4]], [c[2], c[4], c[5]]], [a, b] = through.jacobian(p);
    const times = (v) => C.map((row) => vec.dot(row, v));
    const xx = vec.dot(a, times(a)), xy = vec.dot(a, times(b)), yy = vec.dot(b, times(b));
    const mean = (xx + yy) / 2, off = Math.hypot((xx - yy) / 2, xy), turn = 0.5 * Math.atan2(2 * xy, xx - yy);
    pen.beginPath();
    pen.ellipse(...q, LEVEL * Math.sqrt(Math.max(mean + off, 0.01)), LEVEL * Math.sqrt(Math.max(mean - off, 0.01)), turn, 0, 2 * Math.PI);
    pen.globalAlpha = strong ? 0.16 : 0.09; pen.fillStyle = style; pen.fill();
    pen.globalAlpha = strong ? 0.9 : 0.4; pen.strokeStyle = style; pen.lineWidth = strong ? 1.6 : 1; pen.stroke();
    pen.globalAlpha = 1;
  };

  const ground = () => {
    if (data.floor === null) return;
    const step = 0.5, far = Math.ceil((Math.max(bounds[2][1], data.gate ?? 0) + 1) / step) * step, side = Math.ceil((Math.max(-bounds[0][0], bounds[0][1]) + 1.5) / step) * step;
    for (let x = -side; x <= side + 1e-6; x += step) path([compose(x, floor, 0), compose(x, floor, far)], colour.zero, 1, [], 0.35);
    for (let z = 0; z <= far + 1e-6; z += step) path([compose(-side, floor, z), compose(side, floor, z)], colour.zero, 1, [], 0.35);
  };
  const beyond = () => {
    if (!data.gate || eye.camera) return;
    const drop = floor + 1, r = Math.sqrt(Math.max(data.gate ** 2 - drop ** 2, 0)); // of hips a metre above the floor
    const half = data.camera ? Math.atan(data.camera.width / 2 / data.camera.fx) + 0.12 : 0.9, ring = [];
    for (let k = -40; k <= 40; k++) ring.push(compose(r * Math.sin((k * half) / 40), floor, r * Math.cos((k * half) / 40)));
    path(ring, colour.neutral, 1.4, [6, 5], 0.8);
  };
  const camera = () => {
    const c = data.camera, d = plan ? 0.22 : 0.25;
    const edge = c ? [[0, 0], [c.width, 0], [c.width, c.height], [0, c.height]].map(([u, v]) => [(d * (u - c.cx)) / c.fx, (d * (v - c.cy)) / c.fy, d]) : [[-0.12, -0.09, d], [0.12, -0.09, d], [0.12, 0.09, d], [-0.12, 0.09, d]];
    edge.forEach((p, k) => path([[0, 0, 0], p, edge[(k + 1) % 4]], colour.soft, 1.3));
    if (plan && c) for (const u of [0, c.width]) path([[0, 0, 0], vec.unit([(u - c.cx) / c.fx, 0, 1]).map((x) => 12 * x)], colour.soft, 1, [2, 5], 0.7);
    if (!plan) path([[0, 0, 0], onFloor([0, 0, 0])], colour.soft, 1, [2, 4], 0.6);
  };
  const track = (label, now) => {
    const style = ofLabel(label);
    const parts = { seen: [], blind: [] };
    let last = null;
    for (let n = 0; n < world.count; n++) {
      const p = world.hips(label, n), q = p && onFloor(p), name = p && world.blind(label, n) ? "blind" : "seen";
      for (const each of ["seen", "blind"]) parts[each].push(each === name ? q : null);
      if (q && last && last.name !== name) parts[name].splice(-1, 1, last.q, q);
      last = q && { q, name };
    }
    path(parts.seen, style, plan ? 1.6 : 1.2, [], plan ? 0.6 : 0.45);
    path(parts.blind, style, 1.6, [1.5, 4], 0.9);
    const p = world.hips(label, now);
    if (!p) return;
    if (!plan) { dot(onFloor(p), 3.2, style, null, 0.7); return; }
    path([world.p(label, now, 0), world.p(label, now, 1)], style, 5, [], 0.95);
    dot(p, 6, style, colour.card);
    name(label, through.at(p), [11, -9]);
  };
  const name = (label, at, [dx, dy]) => {
    if (!at) return;
    pen.font = "600 13px system-ui, sans-serif";
    pen.lineWidth = 3.5; pen.strokeStyle = colour.card; pen.lineJoin = "round";
    pen.strokeText(`${label}`, at[0] + dx, at[1] + dy);
    pen.fillStyle = ofLabel(label);
    pen.fillText(`${label}`, at[0] + dx, at[1] + dy);
  };
  const bones = (at, style, thick, alpha) => { for (const [a, b] of data.bones) { const p = at(a), q = at(b); if (p && q) path([p, q], style, thick, [], alpha); } };

  const body = (label, n, chosen, layers) => {
    const style = ofLabel(label), at = (k) => world.p(label, n, k), state = (k) => world.status(label, n, k);
    const thick = Math.max(2.2, Math.min(6, 0.022 * through.scale));
    for (const [a, b] of data.bones) {
      const p = at(a), q = at(b);
      if (!p || !q) continue;
      const worst = Math.max(state(a), state(b));
      path([p, q], style, thick, worst === 1 ? [thick * 1.2, thick * 1.3] : [], worst === 2 ? 0.25 : 0.95);
    }
    const own = chosen.label === label;
    if (layers.ellipses) for (let k = 0; k < FILTERED; k++) if (at(k) && (state(k) === 1 || (own && chosen.keypoint === k))) ellipse(at(k), world.covariance(label, n, k), state(k) === 1 ? colour.predicted : style, own && chosen.keypoint === k);
    for (let k = 0; k < world.keys; k++) {
      const p = at(k);
      if (!p) continue;
      const r = k < FILTERED ? thick * 1.05 : thick * 0.7, word = data.statuses[state(k)];
      if (word === "seen") dot(p, r, style, colour.card);
      else dot(p, r, colour.card, colour[word], word === "lost" ? 0.5 : 1);
      if (own && chosen.keypoint === k) dot(p, r + 4, null, style);
    }
    const top = at(15) || at(14) || at(0) || at(1) || world.hips(label, n);
    if (top) name(label, through.at(top), [-4, -14]);
  };

  let shown = null;
  const show = (frame, chosen, layers) => {
    const ratio = Math.min(devicePixelRatio || 1, 2);
    width = canvas.clientWidth; height = canvas.clientHeight;
    if (!width || !height) return;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) { canvas.width = Math.round(width * ratio); canvas.height = Math.round(height * ratio); }
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    through = projection();
    shown = frame;
    pen.lineCap = "round"; pen.lineJoin = "round";
    if (through.frame) { pen.save(); pen.beginPath(); pen.rect(...through.frame); pen.fillStyle = colour.card; pen.fill(); pen.clip(); }
    else ground();
    beyond();
    if (!through.frame) camera();
    if (layers.tracks || plan) for (const label of data.labels) track(label, frame);
    if (plan) return;
    if (layers.seen) for (const at of world.seen(frame)) { bones(at, colour.raw, 1.6, 0.8); for (let k = 0; k < world.keys; k++) dot(at(k), 2.2, colour.raw, null, 0.8); }
    if (layers.truth) for (const at of world.truths(frame)) bones(at, colour.truth, 1.5, 0.75);
    for (const label of data.labels) if (world.here(label, frame)) body(label, frame, chosen, layers);
    const trail = [];
    for (let n = Math.max(0, frame - 45); n <= frame; n++) trail.push(world.p(chosen.label, n, chosen.keypoint));
    path(trail, ofLabel(chosen.label), 1.8, [], 0.8);
    if (through.frame) { pen.restore(); pen.strokeStyle = colour.zero; pen.lineWidth = 1; pen.strokeRect(...through.frame); }
  };

  // The joint nearest to a place on the canvas, in pixels.
  const pick = (x, y) => {
    let best = null;
    for (const label of data.labels) for (let k = 0; k < (plan ? 1 : FILTERED); k++) {
      const p = plan ? world.hips(label, shown) : world.p(label, shown, k), q = p && through.at(p);
      const d = q ? Math.hypot(q[0] - x, q[1] - y) : Infinity;
      if (d < 14 && (!best || d < best.d)) best = { d, label, keypoint: plan ? null : k };
    }
    return best;
  };
  const turn = (dx, dy) => { if (eye.camera) return; eye.yaw -= dx * 0.008; eye.pitch = Math.max(-0.2, Math.min(1.5, eye.pitch + dy * 0.008)); };
  const move = (dx, dy) => { if (!eye.camera && through) eye.target = vec.add(vec.add(eye.target, through.right, -dx / through.scale), through.top, dy / through.scale); };
  const zoom = (by) => { if (!eye.camera) eye.half = Math.max(0.15, Math.min(12, eye.half * Math.exp(by))); };
  read();
  return { show, pick, turn, move, zoom, read, from: (view) => { eye = home(view); }, ofLabel };
};
