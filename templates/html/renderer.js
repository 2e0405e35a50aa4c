"use strict";
// Draws mechanisms with WebGL 2: solids with light and shadow, lines, arrows, a ground; a view that orbits a point.
//
//   const view = createRenderer(canvas, scene);   // null where the browser has no WebGL 2
//   view.setPose(i, p, R);                        // of mechanism i: as the kernel `frames` gives them, see below
//   view.setArrows(i, arrows);                    // [{kind: "force" | "moment", at: [x, y, z], vector: [x, y, z]}]
//   view.setTrace(i, name, points, count);        // the path of a point: Float32Array of x, y, z; `count` are passed
//   view.options.solids = false; view.draw();     // switches: see `options`; draw() draws at the next refresh
//   view.reset(); view.dispose();
//
// p holds 3 numbers a frame, its origin; R holds 9, its axes x, y, z one after the other, all in the base frame (the
// columns of the kernel's matrices). The scene is plain data:
//
//   scene = {
//     up: [0, 0, 1],                              // against gravity
//     bounds: {low: [x, y, z], high: [x, y, z], points: [[x, y, z]]},  // of everything that moves; points: optional
//     view: {azimuth: -0.9, elevation: 0.35},     // optional
//     thickness: 0.01,                            // radius of a drawn edge [m], optional
//     planes: [{at: [x, y, z], normal: [x, y, z], grid: true}],  // with a grid and shadows, or a plain square
//     markers: [{name, at: [x, y, z]}],
//     meshes: [{vertices: Float32Array, faces: Uint32Array}],
//     mechanisms: [{
//       name, color: "#0072b2",
//       frames: [{name, parent: -1, sensor: false, slide: false, edge: true}],   // edge: from the parent's origin
//       solids: [{layer: "solids", frame: 0, kind: "box", size: [a, b, c], at: [x, y, z], axes: [9 numbers],
//                 color: "#56b4e9", mesh: 0}],
//       lines: [{kind: "spring", ends: [{frame: 0, at: [x, y, z]}, {frame: -1, at: [x, y, z]}]}],
//     }],
//   };
//
// Kinds of solids: box (edges), ellipsoid (axes), cylinder (diameter, diameter, length; along its z), mesh (scales).
// Layers: solids, meshes, joints, contacts; each is a switch. Kinds of lines: rod, gap, spring, cable.

function createRenderer(canvas, scene) {
  const gl = canvas.getContext("webgl2", { antialias: true, stencil: true, preserveDrawingBuffer: true });
  if (!gl) return null;

  // --- vectors ------------------------------------------------------------------------------------------------------

  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const plus = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
  const times = (s, a) => [s * a[0], s * a[1], s * a[2]];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (a) => times(1 / (Math.hypot(...a) || 1), a);
  const apply = (R, v) => [0, 1, 2].map((r) => R[r] * v[0] + R[3 + r] * v[1] + R[6 + r] * v[2]); // R by columns
  const product = (A, B) => [0, 1, 2].flatMap((c) => apply(A, B.slice(3 * c, 3 * c + 3)));
  const aside = (a) => unit(cross(a, Math.abs(a[0]) < 0.6 * Math.hypot(...a) ? [1, 0, 0] : [0, 1, 0]));
  const along = (z) => { // axes whose third one is z
    const x = aside(z);
    return [...x, ...cross(z, x), ...z];
  };
  const EYE = [1, 0, 0, 0, 1, 0, 0, 0, 1], ZERO = [0, 0, 0], ONE = [1, 1, 1];
  const rgb = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255);

  // --- shaders ------------------------------------------------------------------------------------------------------

  const SOLID = [`#version 300 es
    layout(location = 0) in vec3 point; layout(location = 1) in vec3 normal;
    uniform mat4 camera; uniform mat3 turn; uniform vec3 at, scale, up, light; uniform float floorLevel; uniform bool shadow;
    out vec3 facing, place;
    void main() {
      place = at + turn * (scale * point);
      facing = turn * (normal / max(scale, vec3(1e-9)));
      if (shadow) place -= light * (dot(up, place) - floorLevel) / dot(up, light);
      gl_Position = camera * vec4(place, 1.0);
    }`, `#version 300 es
    precision highp float;
    in vec3 facing, place;
    uniform vec3 color, up, light, eye; uniform float alpha, floorLevel; uniform bool shadow, hasFloor;
    out vec4 shown;
    void main() {
      if (shadow) { shown = vec4(0.0, 0.0, 0.0, alpha); return; }
      vec3 n = normalize(facing), v = normalize(eye - place);
      if (dot(n, v) < 0.0) n = -n;
      float diffuse = max(dot(n, light), 0.0), sky = 0.5 + 0.5 * dot(n, up);
      float edge = pow(1.0 - max(dot(n, v), 0.0), 3.0);
      float gloss = pow(max(dot(n, normalize(light + v)), 0.0), 48.0);
      float near = hasFloor ? smoothstep(0.0, 1.0, 0.6 + 0.4 * sky) : 1.0;
      vec3 lit = color * (0.34 + 0.26 * sky + 0.52 * diffuse) * near + vec3(0.16) * gloss + vec3(0.10) * edge;
      shown = vec4(pow(lit, vec3(0.95)), alpha);
    }`];
  const LINE = [`#version 300 es
    layout(location = 0) in vec3 a; layout(location = 1) in vec3 b;
    uniform mat4 camera; uniform vec2 window; uniform float width, lift;
    out vec3 place; out float across;
    void main() { // a quad for each segment, width pixels wide
      vec4 p = camera * vec4(a, 1.0), q = camera * vec4(b, 1.0);
      float nearest = 1e-3 * max(p.w, q.w);
      if (p.w < nearest) p = mix(q, p, (q.w - nearest) / (q.w - p.w));
      if (q.w < nearest) q = mix(p, q, (p.w - nearest) / (p.w - q.w));
      vec2 d = (q.xy / q.w - p.xy / p.w) * window;
      d = length(d) > 0.0 ? normalize(d) : vec2(1.0, 0.0);
      float side = float(gl_VertexID & 1) * 2.0 - 1.0, end = float(gl_VertexID >> 1);
      vec4 at = end > 0.5 ? q : p;
      vec2 shift = (vec2(-d.y, d.x) * side + d * (2.0 * end - 1.0) * 0.5) * width;
      place = mix(a, b, end); across = side;
      gl_Position = at + vec4(shift / window * at.w, -lift * at.w, 0.0);
    }`, `#version 300 es
    precision highp float;
    in vec3 place; in float across;
    uniform vec3 color, centre; uniform float alpha, reach;
    out vec4 shown;
    void main() {
      float fade = reach > 0.0 ? 1.0 - smoothstep(0.35, 1.0, distance(place, centre) / reach) : 1.0;
      shown = vec4(color, alpha * fade * (1.0 - smoothstep(0.7, 1.0, abs(across))));
    }`];

  function compile([vertex, fragment]) {
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) throw new Error(gl.getProgramInfoLog(program));
    const found = { program };
    for (let i = gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS) - 1; i >= 0; i--) {
      const { name } = gl.getActiveUniform(program, i);
      found[name] = gl.getUniformLocation(program, name);
    }
    return found;
  }

  // --- shapes: triangles with normals -------------------------------------------------------------------------------

  function sweep(rows, sides) { // a solid of revolution about z: rows of [radius, z, normal's radius, normal's z]
    const out = [];
    const corner = ([r, z, nr, nz], k) => {
      const [c, s] = [Math.cos(2 * Math.PI * k / sides), Math.sin(2 * Math.PI * k / sides)];
      return [r * c, r * s, z, nr * c, nr * s, nz];
    };
    for (let i = 0; i + 1 < rows.length; i++) for (let k = 0; k < sides; k++) {
      const [a, b, c, d] = [corner(rows[i], k), corner(rows[i], k + 1), corner(rows[i + 1], k + 1), corner(rows[i + 1], k)];
      out.push(...a, ...b, ...c, ...a, ...c, ...d);
    }
    return out;
  }

  function ball(sides = 28) { // of radius 1
    const rows = [];
    for (let i = 0; i <= sides / 2; i++) {
      const t = Math.PI * i / (sides / 2) - Math.PI / 2;
      rows.push([Math.cos(t), Math.sin(t), Math.cos(t), Math.sin(t)]);
    }
    return sweep(rows, sides);
  }

  const tube = () => sweep([[1, 0, 1, 0], [1, 1, 1, 0]], 20); // radius 1, from z = 0 to 1
  const cone = () => sweep([[0, 0, 0, -1], [1, 0, 0, -1], [1, 0, 0.9, 0.4], [0, 1, 0.9, 0.4]], 24);

  function drum(r, h) { // a cylinder of radius r and half length h, with broken edges
    const e = 0.12 * Math.min(r, h), n = Math.SQRT1_2;
    return sweep([[0, -h, 0, -1], [r - e, -h, 0, -1], [r - e, -h, n, -n], [r, -h + e, n, -n], [r, -h + e, 1, 0],
      [r, h - e, 1, 0], [r, h - e, n, n], [r - e, h, n, n], [r - e, h, 0, 1], [0, h, 0, 1]], 36);
  }

  function brick(edges) { // a box with round edges: points of a grid on its faces, moved onto the rounding
    const half = edges.map((x) => x / 2), radius = 0.22 * Math.min(...half), inner = half.map((x) => x - radius), out = [];
    const steps = [-1, -1, -1, -1, 1, 1, 1, 1].map((side, i) => [side, [0, 0.25, 0.5, 1][i < 4 ? i : 7 - i]]);
    const corner = (axis, sign, u, v) => {
      const way = [0, 0, 0], base = [0, 0, 0], [i, j] = [(axis + 1) % 3, (axis + 2) % 3];
      way[axis] = sign;
      way[i] = u[0] * (1 - u[1]);
      way[j] = v[0] * (1 - v[1]);
      base[axis] = sign * inner[axis];
      base[i] = u[0] * inner[i];
      base[j] = v[0] * inner[j];
      const normal = unit(way);
      return [...plus(base, normal, radius), ...normal];
    };
    for (let axis = 0; axis < 3; axis++) for (const sign of [-1, 1]) {
      for (let a = 0; a < 7; a++) for (let b = 0; b < 7; b++) {
        const at = (x, y) => corner(axis, sign, steps[x], steps[y]);
        const [p, q, r, s] = [at(a, b), at(a + 1, b), at(a + 1, b + 1), at(a, b + 1)];
        out.push(...p, ...q, ...r, ...p, ...r, ...s);
      }
    }
    return out;
  }

  function facet({ vertices, faces }) { // normals are averaged over faces that meet at less than 40 degrees
    const at = (i) => [vertices[3 * i], vertices[3 * i + 1], vertices[3 * i + 2]];
    const area = [], meeting = new Map();
    for (let f = 0; f < faces.length; f += 3) {
      const [a, b, c] = [at(faces[f]), at(faces[f + 1]), at(faces[f + 2])];
      area.push(cross(plus(b, a, -1), plus(c, a, -1)));
      for (let k = 0; k < 3; k++) meeting.set(faces[f + k], [...(meeting.get(faces[f + k]) || []), f / 3]);
    }
    const normals = area.map(unit), out = new Float32Array(6 * faces.length);
    for (let i = 0; i < faces.length; i++) {
      const own = normals[Math.floor(i / 3)];
      const sum = meeting.get(faces[i]).reduce((s, f) => (dot(normals[f], own) > 0.766 ? plus(s, area[f]) : s), ZERO);
      out.set([...at(faces[i]), ...unit(Math.hypot(...sum) > 0 ? sum : own)], 6 * i);
    }
    return out;
  }

  // --- buffers ------------------------------------------------------------------------------------------------------

  let programs, shapes, meshes, scratch;

  function upload(numbers) {
    const array = gl.createVertexArray(), buffer = gl.createBuffer();
    gl.bindVertexArray(array);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(numbers), gl.STATIC_DRAW);
    for (const i of [0, 1]) {
      gl.enableVertexAttribArray(i);
      gl.vertexAttribPointer(i, 3, gl.FLOAT, false, 24, 12 * i);
    }
    return { array, count: numbers.length / 6 };
  }

  function build() {
    programs = { solid: compile(SOLID), line: compile(LINE) };
    shapes = { ball: upload(ball()), tube: upload(tube()), cone: upload(cone()) };
    meshes = (scene.meshes || []).map((mesh) => upload(facet(mesh)));
    scratch = { array: gl.createVertexArray(), buffer: gl.createBuffer() };
    scene.mechanisms.forEach((mechanism) => (mechanism.solids || []).forEach((solid) => prepare(solid)));
  }

  const prepared = new Map(); // solid -> geometry, scale
  function prepare(solid) {
    const [a, b, c] = solid.size;
    const make = {
      box: () => [upload(brick(solid.size)), ONE],
      ellipsoid: () => [shapes.ball, times(0.5, solid.size)],
      cylinder: () => [upload(drum((a + b) / 4, c / 2)), ONE],
      mesh: () => [meshes[solid.mesh], solid.size],
    }[solid.kind];
    if (!make) throw new Error(`a solid of kind ${solid.kind}`);
    const [geometry, scale] = make();
    prepared.set(solid, { geometry, scale, color: rgb(solid.color) });
  }

  // --- state --------------------------------------------------------------------------------------------------------

  const options = { solids: true, meshes: true, joints: true, contacts: true, skeleton: true, traces: true, arrows: true,
    axes: false, shadow: true, ground: true, apart: false };
  const up = unit(scene.up || [0, 0, 1]), { low, high } = scene.bounds;
  const size = Math.max(Math.hypot(...plus(high, low, -1)), 1e-6), middle = times(0.5, plus(low, high));
  const thickness = scene.thickness || 0.008 * size;
  const poses = scene.mechanisms.map((m) => ({ p: new Float64Array(3 * m.frames.length), R: [], arrows: [], traces: new Map() }));
  poses.forEach((pose, i) => scene.mechanisms[i].frames.forEach(() => pose.R.push(...EYE)));
  const first = Math.abs(up[2]) > 0.5 ? [1, 0, 0] : [0, 0, 1]; // azimuth 0
  const east = unit(plus(first, up, -dot(first, up))), north = cross(up, east);
  const home = { azimuth: -0.9, elevation: 0.35, ...scene.view };
  let view, wide = 1, tall = 1, asked = 0, colors = {}, gone = false;

  const shiftOf = (i) => { // of mechanism i where they stand side by side
    if (!options.apart || poses.length < 2) return ZERO;
    const way = plus(times(-Math.sin(home.azimuth), east), north, Math.cos(home.azimuth));
    const width = Math.abs(dot(way, plus(high, low, -1))) + 0.18 * size;
    return times((i - (poses.length - 1) / 2) * width, way);
  };

  function lookFrom(azimuth, elevation) { // right, up and towards the eye
    const [ca, sa, ce, se] = [Math.cos(azimuth), Math.sin(azimuth), Math.cos(elevation), Math.sin(elevation)];
    const flat = plus(times(ca, east), north, sa);
    return [plus(times(-sa, east), north, ca), plus(times(-se, flat), up, ce), plus(times(ce, flat), up, se)];
  }

  const SLOPE = Math.tan(Math.PI / 12); // half the angle of the view
  function reset() { // everything in sight, between the page's title and its controls
    const [right, above, eye] = lookFrom(home.azimuth, home.elevation);
    const room = [wide / tall * 0.94, 0.94 - Math.min(0.35, 150 * devicePixelRatio / tall)];
    let distance = 0.1 * size;
    const corners = [...Array(8).keys()].map((k) => [0, 1, 2].map((c) => ((k >> c) & 1 ? high[c] : low[c])));
    const outer = scene.bounds.points || corners;
    for (const point of outer) for (let i = 0; i < poses.length; i++) {
      const d = plus(plus(point, shiftOf(i)), middle, -1);
      const need = Math.max(Math.abs(dot(d, right)) / room[0], Math.abs(dot(d, above)) / Math.max(room[1], 0.3)) / SLOPE;
      distance = Math.max(distance, need + dot(d, eye));
    }
    view = { ...home, distance, centre: plus(middle, above, -0.02 * distance * SLOPE * 2) };
    draw();
  }

  function camera() { // and the matrix of the projection, by columns
    const [right, above, eye] = lookFrom(view.azimuth, view.elevation), at = plus(view.centre, eye, view.distance);
    const near = 0.02 * view.distance, far = view.distance + 12 * size, s = 1 / SLOPE, ratio = wide / tall;
    const A = (far + near) / (near - far), B = 2 * far * near / (near - far), matrix = [];
    for (let c = 0; c < 3; c++) matrix.push(s / ratio * right[c], s * above[c], A * eye[c], -eye[c]);
    matrix.push(-s / ratio * dot(right, at), -s * dot(above, at), B - A * dot(eye, at), dot(eye, at));
    return { matrix, at, right, above, eye };
  }

  // --- drawing ------------------------------------------------------------------------------------------------------

  function readColors() {
    const style = getComputedStyle(canvas);
    const read = (name, other) => (/^#[0-9a-f]{6}/i.test(style.getPropertyValue(name).trim()) ? style.getPropertyValue(name).trim().slice(0, 7) : other);
    colors = { paper: rgb(read("--paper", "#f4f6f9")), faint: rgb(read("--faint", "#b9c3cf")), ink: rgb(read("--ink", "#1d2733")),
      bone: rgb(read("--bone", "#5d6b7a")), sensor: rgb(read("--sensor", "#d55e00")), marker: rgb(read("--marker", "#e69f00")),
      force: rgb(read("--force", "#d55e00")), moment: rgb(read("--moment", "#cc79a7")), contact: rgb(read("--contact", "#009e73")) };
  }

  function segments(points, color, width, { loose = false, alpha = 1, count = Infinity, reach = 0, lift = 1e-4 } = {}) {
    const use = programs.line, step = loose ? 24 : 12; // loose: pairs of points; else a path
    const total = Math.min(loose ? points.length / 6 : points.length / 3 - 1, count);
    if (total < 1) return;
    gl.useProgram(use.program);
    gl.bindVertexArray(scratch.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, scratch.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, points instanceof Float32Array ? points : new Float32Array(points), gl.DYNAMIC_DRAW);
    for (const i of [0, 1]) {
      gl.enableVertexAttribArray(i);
      gl.vertexAttribPointer(i, 3, gl.FLOAT, false, step, 12 * i);
      gl.vertexAttribDivisor(i, 1);
    }
    gl.uniformMatrix4fv(use.camera, false, eyes.matrix);
    gl.uniform2f(use.window, wide, tall);
    gl.uniform1f(use.width, width * devicePixelRatio);
    gl.uniform1f(use.lift, lift);
    gl.uniform3fv(use.color, color);
    gl.uniform3fv(use.centre, middle);
    gl.uniform1f(use.alpha, alpha);
    gl.uniform1f(use.reach, reach);
    gl.depthMask(false);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, total);
    gl.depthMask(true);
  }

  let eyes, light;
  function solids(items, floor) { // with a floor: their shadows on it
    const use = programs.solid;
    gl.useProgram(use.program);
    gl.uniformMatrix4fv(use.camera, false, eyes.matrix);
    gl.uniform3fv(use.up, floor ? floor.normal : up);
    gl.uniform3fv(use.light, light);
    gl.uniform3fv(use.eye, eyes.at);
    gl.uniform1i(use.shadow, floor ? 1 : 0);
    gl.uniform1i(use.hasFloor, options.shadow ? 1 : 0);
    gl.uniform1f(use.floorLevel, floor ? dot(floor.normal, floor.at) : 0);
    for (const { geometry, turn, at, scale, color, alpha = 1 } of items) {
      gl.bindVertexArray(geometry.array);
      gl.uniformMatrix3fv(use.turn, false, turn);
      gl.uniform3fv(use.at, at);
      gl.uniform3fv(use.scale, scale);
      gl.uniform3fv(use.color, color);
      gl.uniform1f(use.alpha, floor ? 0.16 * alpha : alpha);
      if (alpha < 1 && !floor) gl.depthMask(false);
      gl.drawArrays(gl.TRIANGLES, 0, geometry.count);
      gl.depthMask(true);
    }
  }

  const stick = (a, b, radius, color) => {
    const d = plus(b, a, -1), length = Math.hypot(...d);
    return { geometry: shapes.tube, turn: along(length ? times(1 / length, d) : up), at: a, scale: [radius, radius, length], color };
  };
  const bead = (at, radius, color) => ({ geometry: shapes.ball, turn: EYE, at, scale: [radius, radius, radius], color });

  function collect(items, lines, front) { // the solids and lines of the present poses; arrows stand in front
    scene.mechanisms.forEach((mechanism, m) => {
      if (poses[m].hidden) return;
      const { p, R, arrows } = poses[m], shift = shiftOf(m);
      const origin = (f) => (f < 0 ? shift : plus([p[3 * f], p[3 * f + 1], p[3 * f + 2]], shift));
      const turnOf = (f) => (f < 0 ? EYE : Array.prototype.slice.call(R, 9 * f, 9 * f + 9));
      const placed = ({ frame, at }) => plus(origin(frame), apply(turnOf(frame), at));
      const hue = mechanism.color ? rgb(mechanism.color) : colors.bone;
      for (const solid of mechanism.solids || []) {
        if (!options[solid.layer]) continue;
        const { geometry, scale, color } = prepared.get(solid), turn = turnOf(solid.frame);
        const alpha = solid.layer === "contacts" ? 0.45 : solid.alpha || 1;
        items.push({ geometry, scale, color, alpha, turn: product(turn, solid.axes || EYE), at: placed({ at: ZERO, ...solid }) });
      }
      mechanism.frames.forEach((frame, f) => {
        const at = origin(f), start = origin(frame.parent);
        if (options.skeleton && frame.edge !== false) { // a floating base hangs on nothing
          items.push(stick(start, at, (frame.slide ? 0.45 : 1) * thickness, hue), bead(at, thickness, hue));
        }
        if (frame.sensor) items.push(bead(at, 1.35 * thickness, colors.sensor));
        if (options.axes) [0, 1, 2].forEach((c) => {
          const tip = plus(at, turnOf(f).slice(3 * c, 3 * c + 3), 0.06 * size);
          items.push(stick(at, tip, 0.3 * thickness, AXES[c]));
        });
      });
      for (const line of mechanism.lines || []) {
        const [a, b] = line.ends.map(placed);
        if (line.kind === "rod") items.push(stick(a, b, 0.8 * thickness, hue), bead(a, thickness, hue), bead(b, thickness, hue));
        else if (line.kind === "spring") lines.push({ points: coil(a, b), color: colors.ink, width: 2.2 });
        else lines.push({ points: [...a, ...b], color: line.kind === "gap" ? colors.sensor : colors.ink, width: line.kind === "gap" ? 1.5 : 2.2 });
      }
      if (options.arrows) for (const arrow of arrows) front.push(...drawArrow(arrow, shift));
      if (options.traces) for (const { points, count } of poses[m].traces.values()) {
        const moved = shift === ZERO ? points : points.map((x, i) => x + shift[i % 3]);
        const color = poses.length > 1 ? hue : colors.sensor;
        lines.push({ points: moved, color, width: 1.6, alpha: 0.28 }, { points: moved, color, width: 2.4, count });
      }
    });
    for (const marker of scene.markers || []) for (let i = 0; i < poses.length; i++) {
      if (i && !options.apart) break;
      const at = plus(marker.at, shiftOf(i)), r = 2.1 * thickness;
      items.push({ geometry: shapes.cone, turn: along(up), at, scale: [r, r, 1.4 * r], color: colors.marker });
      items.push({ geometry: shapes.cone, turn: along(times(-1, up)), at, scale: [r, r, 1.4 * r], color: colors.marker });
    }
  }

  const AXES = ["#d1495b", "#3a9d5d", "#3b7dd8"].map(rgb);

  function coil(a, b) { // a helix with straight ends
    const d = plus(b, a, -1), [x, y] = [aside(d), unit(cross(d, aside(d)))], points = [...a], turns = 9, N = 14 * turns;
    for (let i = 0; i <= N; i++) {
      const t = i / N, r = 2.2 * thickness * Math.min(1, 8 * t, 8 * (1 - t)), w = 2 * Math.PI * turns * t;
      points.push(...plus(plus(plus(a, d, 0.12 + 0.76 * t), x, r * Math.cos(w)), y, r * Math.sin(w)));
    }
    return [...points, ...b];
  }

  function drawArrow({ kind, at, vector, color }, shift) {
    const length = Math.hypot(...vector), foot = plus(at, shift), hue = color ? rgb(color) : colors[kind];
    if (!(length > 0.004 * size)) return [];
    const head = Math.min(3.2 * thickness, 0.5 * length), way = unit(vector), r = 0.62 * thickness;
    const tip = (base, direction, h) => ({ geometry: shapes.cone, turn: along(direction), at: base, scale: [0.6 * h, 0.6 * h, h], color: hue });
    if (kind !== "moment") return [stick(foot, plus(foot, vector, 1 - head / length), r, hue), tip(plus(foot, vector, 1 - head / length), way, head)];
    const R = Math.min(Math.max(0.3 * length, 3.2 * thickness), 0.09 * size), angle = Math.min(5.4, length / R); // around its axis
    const x = aside(way), y = cross(way, x), parts = [], N = Math.max(3, Math.ceil(5 * angle));
    const on = (t) => plus(plus(foot, x, R * Math.cos(t)), y, R * Math.sin(t));
    for (let i = 0; i < N; i++) parts.push(stick(on(angle * i / N), on(angle * (i + 1) / N), r, hue));
    const h = Math.min(3.2 * thickness, 0.5 * R * angle);
    return [...parts, tip(on(angle), plus(times(-Math.sin(angle), x), y, Math.cos(angle)), h)];
  }

  function drawPlane({ at, normal, grid }) {
    const n = unit(normal), x = Math.abs(dot(n, east)) < 0.9 ? unit(plus(east, n, -dot(n, east))) : aside(n), y = cross(n, x);
    const centre = plus(middle, n, dot(n, plus(at, middle, -1))), points = [];
    const spread = options.apart ? 1 + 0.5 * poses.length : 1;
    const step = 10 ** Math.round(Math.log10(size / 6)), reach = Math.ceil((grid ? 1.5 : 0.6) * spread * size / step);
    const [cx, cy] = [x, y].map((e) => Math.round(dot(plus(centre, at, -1), e) / step));
    const corner = (i, j) => plus(plus(at, x, (cx + i) * step), y, (cy + j) * step);
    for (let i = -reach; i <= reach; i++) {
      points.push(...corner(i, -reach), ...corner(i, reach), ...corner(-reach, i), ...corner(reach, i));
    }
    segments(points, colors.faint, 1.2, { loose: true, alpha: 0.9, reach: (grid ? 1.4 : 0.8) * spread * size, lift: 0 });
  }

  function fit() {
    const w = Math.max(1, Math.round(canvas.clientWidth * devicePixelRatio));
    const h = Math.max(1, Math.round(canvas.clientHeight * devicePixelRatio));
    if (w === wide && h === tall && canvas.width === w && canvas.height === h) return;
    [wide, tall, canvas.width, canvas.height] = [w, h, w, h];
    if (!moved) reset();
  }

  function paint() {
    asked = 0;
    if (gone || gl.isContextLost()) return;
    fit();
    readColors();
    eyes = camera();
    light = unit(plus(plus(times(0.9, up), eyes.right, -0.35), eyes.eye, 0.45));
    gl.viewport(0, 0, wide, tall);
    gl.clearColor(...colors.paper, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    const items = [], lines = [], front = [], planes = options.ground ? scene.planes || [] : [];
    collect(items, lines, front);
    planes.forEach(drawPlane);
    const floor = planes.find((plane) => plane.grid);
    if (floor && options.shadow && dot(eyes.at, floor.normal) > dot(floor.at, floor.normal)) {
      gl.enable(gl.STENCIL_TEST); // each pixel is darkened once
      gl.stencilFunc(gl.EQUAL, 0, 255);
      gl.stencilOp(gl.KEEP, gl.KEEP, gl.INCR);
      gl.depthMask(false);
      gl.disable(gl.DEPTH_TEST);
      solids(items.filter((item) => dot(plus(item.at, floor.at, -1), floor.normal) > -0.02 * size), floor);
      gl.enable(gl.DEPTH_TEST);
      gl.depthMask(true);
      gl.disable(gl.STENCIL_TEST);
    }
    solids(items.filter((item) => !(item.alpha < 1)));
    lines.forEach(({ points, color, width, ...more }) => segments(points, color, width, more));
    solids(items.filter((item) => item.alpha < 1));
    gl.depthRange(0, 0.01);
    solids(front);
    gl.depthRange(0, 1);
  }

  function draw() {
    if (!asked && !gone) asked = requestAnimationFrame(paint);
  }

  // --- hands --------------------------------------------------------------------------------------------------------

  const fingers = new Map();
  let moved = false;
  const zoom = (factor) => { view.distance = Math.max(0.05 * size, Math.min(30 * size, view.distance / factor)); };
  function pan(dx, dy) {
    const [right, above] = lookFrom(view.azimuth, view.elevation), s = 2 * view.distance * SLOPE / canvas.clientHeight;
    view.centre = plus(plus(view.centre, right, -s * dx), above, s * dy);
  }
  const listeners = {
    pointerdown(event) {
      canvas.setPointerCapture(event.pointerId);
      fingers.set(event.pointerId, event);
    },
    pointerup: (event) => fingers.delete(event.pointerId),
    pointercancel: (event) => fingers.delete(event.pointerId),
    pointermove(event) {
      const old = fingers.get(event.pointerId);
      if (!old) return;
      const dx = event.clientX - old.clientX, dy = event.clientY - old.clientY;
      if (fingers.size === 2) {
        const other = [...fingers.values()].find((finger) => finger.pointerId !== event.pointerId);
        const gap = (a) => Math.hypot(a.clientX - other.clientX, a.clientY - other.clientY) || 1;
        zoom(gap(event) / gap(old));
        pan(dx / 2, dy / 2);
      } else if (event.shiftKey || event.buttons & 6) {
        pan(dx, dy);
      } else {
        view.azimuth -= 0.008 * dx;
        view.elevation = Math.max(-1.55, Math.min(1.55, view.elevation + 0.008 * dy));
      }
      moved = true;
      fingers.set(event.pointerId, event);
      draw();
    },
    wheel(event) {
      event.preventDefault();
      zoom(Math.exp(-0.0012 * event.deltaY));
      moved = true;
      draw();
    },
    dblclick: () => { moved = false; reset(); },
    contextmenu: (event) => event.preventDefault(),
    webglcontextlost: (event) => event.preventDefault(),
    webglcontextrestored() { build(); draw(); },
  };
  for (const [name, listener] of Object.entries(listeners)) canvas.addEventListener(name, listener, { passive: false });
  const watcher = new ResizeObserver(draw);
  watcher.observe(canvas);

  build();
  reset();
  return {
    options,
    draw,
    reset() { moved = false; reset(); },
    setPose(i, p, R) { Object.assign(poses[i], { p, R }); draw(); },
    setShown(i, shown) { poses[i].hidden = !shown; draw(); },
    setArrows(i, arrows) { poses[i].arrows = arrows; draw(); },
    setTrace(i, name, points, count) { poses[i].traces.set(name, { points, count }); draw(); },
    dispose() {
      gone = true;
      cancelAnimationFrame(asked);
      watcher.disconnect();
      for (const [name, listener] of Object.entries(listeners)) canvas.removeEventListener(name, listener);
      const loser = gl.getExtension("WEBGL_lose_context");
      if (loser) loser.loseContext();
    },
  };
}
