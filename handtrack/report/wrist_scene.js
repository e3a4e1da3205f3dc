"use strict";
// The scene in space: metres, camera axes (x right, y down, z forward). Nothing here knows of curves or buttons.
const bytesOf = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
const floatsOf = (text) => new Float32Array(bytesOf(text));

const vec = {
  sub: (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]],
  add: (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]],
  dot: (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2],
  cross: (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]],
  unit: (a) => { const n = Math.hypot(...a) || 1; return [a[0] / n, a[1] / n, a[2] / n]; },
  good: (a) => a.every(Number.isFinite),
};

// Column-major 4 x 4, as WebGL wants them.
const times = (a, b) => {
  const out = new Float32Array(16);
  for (let c = 0; c < 4; c++) for (let r = 0; r < 4; r++) for (let k = 0; k < 4; k++) out[4 * c + r] += a[4 * k + r] * b[4 * c + k];
  return out;
};
const placed = (x, y, z, t) => new Float32Array([...x, 0, ...y, 0, ...z, 0, ...t, 1]);
const looking = (eye, right, up, back) => new Float32Array([
  right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0,
  -vec.dot(right, eye), -vec.dot(up, eye), -vec.dot(back, eye), 1]);
const lens = (tan, aspect, near, far) => new Float32Array([
  1 / (tan * aspect), 0, 0, 0, 0, 1 / tan, 0, 0, 0, 0, -(far + near) / (far - near), -1, 0, 0, (-2 * far * near) / (far - near), 0]);
// Inverse transpose of the 3 x 3 part, up to scale: cross products of its columns.
const normalsOf = (m) => {
  const x = [m[0], m[1], m[2]], y = [m[4], m[5], m[6]], z = [m[8], m[9], m[10]];
  return new Float32Array([...vec.cross(y, z), ...vec.cross(z, x), ...vec.cross(x, y)]);
};

const ball = (rings = 16, parts = 28) => {
  const out = [];
  const at = (i, j) => {
    const a = (Math.PI * i) / rings, b = (2 * Math.PI * j) / parts;
    return [Math.sin(a) * Math.cos(b), Math.sin(a) * Math.sin(b), Math.cos(a)];
  };
  for (let i = 0; i < rings; i++) for (let j = 0; j < parts; j++)
    for (const p of [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j), at(i + 1, j + 1), at(i, j + 1)]) out.push(...p, ...p);
  return new Float32Array(out);
};
const tube = (parts = 28) => {
  const out = [];
  for (let j = 0; j < parts; j++) {
    const n = [j, j + 1].map((k) => [Math.cos((2 * Math.PI * k) / parts), Math.sin((2 * Math.PI * k) / parts)]);
    for (const [k, z] of [[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]]) out.push(...n[k], z, ...n[k], 0);
  }
  return new Float32Array(out);
};
const faces = (corners) => {
  const out = new Float32Array(corners.length * 2);
  for (let t = 0; t < corners.length; t += 9) {
    const [a, b, c] = [0, 3, 6].map((k) => [corners[t + k], corners[t + k + 1], corners[t + k + 2]]);
    const n = vec.unit(vec.cross(vec.sub(b, a), vec.sub(c, a)));
    [a, b, c].forEach((p, k) => out.set([...p, ...n], 2 * t + 6 * k));
  }
  return out;
};

const SOLID = [`attribute vec3 p; attribute vec3 n; uniform mat4 view; uniform mat4 lens; uniform mat4 model; uniform mat3 turn;
  varying vec3 at; varying vec3 nn; void main() { vec4 q = view * model * vec4(p, 1.0); at = q.xyz;
  nn = mat3(view[0].xyz, view[1].xyz, view[2].xyz) * (turn * n); gl_Position = lens * q; }`,
`precision mediump float; uniform vec4 colour; uniform float shine; varying vec3 at; varying vec3 nn;
  void main() { vec3 n = normalize(nn); vec3 v = normalize(-at); if (dot(n, v) < 0.0) n = -n;
  float key = max(dot(n, normalize(vec3(0.35, 0.75, 0.55))), 0.0); float lit = 0.42 + 0.2 * dot(n, v) + 0.42 * key;
  float rim = pow(1.0 - abs(dot(n, v)), 2.5) * shine; float spot = 0.16 * pow(max(dot(reflect(-v, n), normalize(vec3(0.35, 0.75, 0.55))), 0.0), 24.0);
  gl_FragColor = vec4(colour.rgb * lit + spot * (1.0 - shine), clamp(colour.a + rim * 0.5, 0.0, 1.0)); }`];
const FLAT = [`attribute vec3 p; uniform mat4 view; uniform mat4 lens; uniform float size; uniform float nearer;
  void main() { vec4 q = view * vec4(p, 1.0); q.xyz *= nearer; gl_Position = lens * q; gl_PointSize = clamp(size / -q.z, 1.5, 40.0); }`,
`precision mediump float; uniform vec4 colour; uniform float dots; void main() {
  if (dots > 0.5) { vec2 d = gl_PointCoord - 0.5; float r = dot(d, d); if (r > 0.25) discard; gl_FragColor = vec4(colour.rgb * (1.15 - 1.6 * r), colour.a); }
  else gl_FragColor = colour; }`];

const makeScene = (canvas, data) => {
  const gl = canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: true });
  if (!gl) return null;
  const built = ([vertex, fragment]) => {
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.bindAttribLocation(program, 0, "p");
    gl.bindAttribLocation(program, 1, "n");
    gl.linkProgram(program);
    const places = {};
    return { program, at: (name) => (name in places ? places[name] : (places[name] = gl.getUniformLocation(program, name))) };
  };
  const solid = built(SOLID), flat = built(FLAT);
  const stored = (values) => {
    const buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
    return buffer;
  };
  const mesh = (values) => ({ buffer: stored(values), count: values.length / 6 });
  const shapes = { ball: mesh(ball()), tube: mesh(tube()) };
  const loose = gl.createBuffer();

  // What there is in every frame.
  const frames = data.time.length;
  const joints = floatsOf(data.joints), seen = floatsOf(data.seen), axes = floatsOf(data.ellipsoid);
  const truth = data.truth && floatsOf(data.truth);
  const robot = data.robot && { links: data.robot.links, ends: floatsOf(data.robot.ends), radius: floatsOf(data.robot.radius) };
  const cloud = new Int16Array(bytesOf(data.cloud.data));
  const room = data.room && { mesh: mesh(faces(floatsOf(data.room.triangles))), edges: floatsOf(data.room.edges) };
  if (room) room.lines = stored(room.edges);
  const three = (values, frame, joint = 0, per = 3) => { const k = 3 * (per * frame + joint); return [values[k], values[k + 1], values[k + 2]]; };

  // The view: about a place, or through the camera.
  const up = vec.unit(data.up);
  const forward = vec.unit(vec.sub([0, 0, 1], up.map((x) => x * up[2])));
  const aside = vec.cross(forward, up);
  const spots = [];
  for (let n = 0; n < frames; n++) for (let k = 0; k < 3; k++) { const p = three(joints, n, k); if (vec.good(p) && data.status[n] < 3) spots.push(p); }
  const middle = (k) => { const v = spots.map((p) => p[k]).sort((a, b) => a - b); return v.length ? v[v.length >> 1] : [0, 0, 2][k]; };
  const home = () => ({ target: [middle(0), middle(1), middle(2)], yaw: 0.75, pitch: 0.38, far: 1.45, camera: false });
  let eye = home();
  const basis = () => {
    if (eye.camera) return { at: [0, 0, 0], right: [1, 0, 0], up: [0, -1, 0], back: [0, 0, -1] };
    const level = vec.add(aside.map((x) => x * Math.sin(eye.yaw)), forward, -Math.cos(eye.yaw));
    const back = vec.unit(vec.add(level.map((x) => x * Math.cos(eye.pitch)), up, Math.sin(eye.pitch)));
    const right = vec.unit(vec.cross(up, back));
    return { at: vec.add(eye.target, back, eye.far), right, up: vec.cross(back, right), back };
  };

  const colours = {};
  const read = () => {
    const style = getComputedStyle(document.documentElement);
    for (const name of ["tracked", "predicted", "uncertain", "lost", "room", "robot", "truth", "sky", "soft"]) {
      const text = style.getPropertyValue(`--${name}`).trim();
      const short = text.length === 4 ? `#${[...text.slice(1)].map((c) => c + c).join("")}` : text;
      colours[name] = [1, 3, 5].map((k) => parseInt(short.slice(k, k + 2), 16) / 255);
    }
  };

  let view, through;
  const use = (shader) => {
    gl.useProgram(shader.program);
    gl.uniformMatrix4fv(shader.at("view"), false, view);
    gl.uniformMatrix4fv(shader.at("lens"), false, through);
  };
  const same = placed([1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]);
  const draw = (shape, model, colour, alpha = 1, shine = 0) => {
    gl.bindBuffer(gl.ARRAY_BUFFER, shape.buffer);
    gl.enableVertexAttribArray(0);
    gl.enableVertexAttribArray(1);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 24, 0);
    gl.vertexAttribPointer(1, 3, gl.FLOAT, false, 24, 12);
    gl.uniformMatrix4fv(solid.at("model"), false, model);
    gl.uniformMatrix3fv(solid.at("turn"), false, normalsOf(model));
    gl.uniform4f(solid.at("colour"), ...colour, alpha);
    gl.uniform1f(solid.at("shine"), shine);
    gl.drawArrays(gl.TRIANGLES, 0, shape.count);
  };
  const sphere = (p, r, colour, alpha) => vec.good(p) && draw(shapes.ball, placed([r, 0, 0], [0, r, 0], [0, 0, r], p), colour, alpha);
  const pill = (a, b, r, colour, alpha) => {
    if (!vec.good(a) || !vec.good(b)) return;
    const way = vec.sub(b, a), unit = vec.unit(way);
    const x = vec.unit(vec.cross(unit, Math.abs(unit[0]) < 0.7 ? [1, 0, 0] : [0, 1, 0])), y = vec.cross(unit, x);
    draw(shapes.tube, placed(x.map((v) => v * r), y.map((v) => v * r), way, a), colour, alpha);
    sphere(a, r, colour, alpha);
    sphere(b, r, colour, alpha);
  };
  const thin = (values, mode, colour, alpha, size = 0, nearer = 0.9995, buffer = null) => {
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer || loose);
    if (!buffer) gl.bufferData(gl.ARRAY_BUFFER, values, gl.STREAM_DRAW);
    gl.enableVertexAttribArray(0);
    gl.disableVertexAttribArray(1);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 12, 0);
    gl.uniform4f(flat.at("colour"), ...colour, alpha);
    gl.uniform1f(flat.at("dots"), mode === gl.POINTS ? 1 : 0);
    gl.uniform1f(flat.at("size"), size);
    gl.uniform1f(flat.at("nearer"), nearer);
    gl.drawArrays(mode, 0, values.length / 3);
  };
  const trail = (values, frame) => {
    const out = [];
    for (let n = Math.max(0, frame - 30); n <= frame; n++) { const p = three(values, n, 2); if (vec.good(p)) out.push(...p); }
    return new Float32Array(out);
  };
  const frustum = () => {
    const c = data.camera, d = 0.22, out = [];
    const corner = [[0, 0], [c.width, 0], [c.width, c.height], [0, c.height]].map(([u, v]) => [(d * (u - c.cx)) / c.fx, (d * (v - c.cy)) / c.fy, d]);
    corner.forEach((p, k) => out.push(0, 0, 0, ...p, ...p, ...corner[(k + 1) % 4]));
    return new Float32Array(out);
  };
  const pyramid = frustum();

  const show = (frame, layers) => {
    const ratio = Math.min(devicePixelRatio || 1, 2), width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
    if (!width || !height) return;
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    const b = basis(), c = data.camera;
    const tan = eye.camera ? Math.max(c.height / 2 / c.fy, (c.width / 2 / c.fx) * (height / width)) : 0.42;
    view = looking(b.at, b.right, b.up, b.back);
    through = lens(tan, width / height, 0.05, 60);
    gl.viewport(0, 0, width, height);
    gl.clearColor(...colours.sky, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    gl.depthMask(true);
    const now = colours[data.statuses[data.status[frame]]];
    const [shoulder, elbow, wrist] = [0, 1, 2].map((k) => three(joints, frame, k));
    const arm = now.map((x) => 0.35 * x + 0.5);
    use(solid);
    if (room && layers.room === "solid") draw(room.mesh, same, colours.room);
    pill(shoulder, elbow, 0.026, arm);
    pill(elbow, wrist, 0.02, arm);
    sphere(shoulder, 0.036, arm);
    sphere(elbow, 0.032, arm);
    sphere(wrist, 0.03, now);
    if (truth && layers.truth) {
      const real = [0, 1, 2].map((k) => three(truth, frame, k));
      pill(real[0], real[1], 0.009, colours.truth);
      pill(real[1], real[2], 0.009, colours.truth);
      sphere(real[2], 0.022, colours.truth);
    }
    if (robot && layers.robot)
      for (let k = 0; k < robot.links; k++)
        pill(three(robot.ends, frame, 2 * k, 2 * robot.links), three(robot.ends, frame, 2 * k + 1, 2 * robot.links), robot.radius[frame * robot.links + k], colours.robot);
    use(flat);
    gl.enable(gl.BLEND);
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    if (layers.cloud && data.cloud.count) {
      const n = 3 * data.cloud.count, points = new Float32Array(n);
      for (let k = 0; k < n; k++) points[k] = cloud[frame * n + k] / 1000;
      thin(points, gl.POINTS, now, 0.85, (0.009 * height) / tan);
    }
    if (!eye.camera) {
      thin(pyramid, gl.LINES, colours.soft, 0.9);
      if (layers.sight && vec.good(wrist)) thin(new Float32Array([0, 0, 0, ...wrist]), gl.LINES, now, 0.8);
    }
    thin(trail(joints, frame), gl.LINE_STRIP, now, 0.9);
    if (truth && layers.truth) thin(trail(truth, frame), gl.LINE_STRIP, colours.truth, 0.6);
    const guess = three(seen, frame, 2);
    if (vec.good(guess)) {
      const ring = [];
      for (let k = 0; k < 40; k++) ring.push(...vec.add(vec.add(guess, b.right, 0.05 * Math.cos((k * Math.PI) / 20)), b.up, 0.05 * Math.sin((k * Math.PI) / 20)));
      thin(new Float32Array(ring), gl.LINE_LOOP, colours.truth, data.sensor[frame] === 0 ? 0.75 : 0.4);
    }
    if (room && layers.room !== "off") thin(room.edges, gl.LINES, colours.soft, layers.room === "solid" ? 0.75 : 0.5, 0, 0.999, room.lines);
    use(solid);
    gl.depthMask(false);
    if (layers.ellipsoid) {
      const k = 9 * frame; // rows of the half axes; the ellipsoid's own x, y, z are the columns
      const column = (j) => [axes[k + j], axes[k + 3 + j], axes[k + 6 + j]].map((v) => v || 1e-6);
      const model = placed(column(0), column(1), column(2), wrist);
      gl.enable(gl.CULL_FACE);
      for (const side of [gl.FRONT, gl.BACK]) { gl.cullFace(side); draw(shapes.ball, model, now, 0.14, 1); }
      gl.disable(gl.CULL_FACE);
    }
    if (room && layers.room === "glass") draw(room.mesh, same, colours.room, 0.1);
    gl.depthMask(true);
  };

  const turn = (dx, dy) => {
    if (eye.camera) eye = { ...home(), yaw: 0, pitch: 0.1 };
    eye.yaw -= dx * 0.008;
    eye.pitch = Math.max(-1.5, Math.min(1.5, eye.pitch + dy * 0.008));
  };
  const move = (dx, dy) => {
    if (eye.camera) return;
    const b = basis(), s = (eye.far * 0.84) / canvas.clientHeight;
    eye.target = vec.add(vec.add(eye.target, b.right, -dx * s), b.up, dy * s);
  };
  const zoom = (by) => { if (!eye.camera) eye.far = Math.max(0.25, Math.min(15, eye.far * Math.exp(by))); };
  const from = (name) => { eye = { ...home(), ...(name === "camera" ? { camera: true } : name === "top" ? { yaw: 0, pitch: 1.5, far: 2.4 } : {}) }; };
  const where = () => (eye.camera ? "camera" : null);
  read();
  return { show, turn, move, zoom, from, where, read };
};
