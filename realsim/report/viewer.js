// A small 3D viewer for report pages. Each <div class="viewer3d"> holds its layers as JSON (see viewer3d.py).
// Faces are lit by the normal that screen-space derivatives give, so no normals are stored and edges stay sharp.
"use strict";
(() => {
  const VERTEX = `#version 300 es
    in vec3 position; in vec3 color;
    uniform mat4 view; uniform mat4 projection; uniform vec3 low; uniform float size; uniform float point;
    out vec3 eye; out vec3 tint;
    void main() {
      vec4 p = view * vec4(low + position * size, 1.0);
      eye = p.xyz; tint = color; gl_Position = projection * p; gl_PointSize = point;
    }`;
  const FRAGMENT = `#version 300 es
    precision highp float;
    in vec3 eye; in vec3 tint;
    uniform float opacity; uniform bool lit; uniform mat4 view;
    out vec4 result;
    void main() {
      vec3 c = tint;
      if (lit) {
        vec3 n = normalize(cross(dFdx(eye), dFdy(eye)));
        if (dot(n, eye) > 0.0) n = -n;
        vec3 sun = normalize(mat3(view) * vec3(0.35, -0.5, 0.8));
        vec3 sky = mat3(view) * vec3(0.0, 0.0, 1.0);
        c *= 0.54 + 0.44 * max(dot(n, sun), 0.0) + 0.14 * dot(n, sky) + 0.10 * max(dot(n, -normalize(eye)), 0.0);
      }
      result = vec4(c * opacity, opacity);
    }`;

  // Integers of `width` bytes, as _deflated of viewer3d.py packs them.
  async function unpack(text, width) {
    const packed = new Blob([Uint8Array.from(atob(text), c => c.charCodeAt(0))]);
    const planes = new Uint8Array(await new Response(packed.stream().pipeThrough(new DecompressionStream("deflate"))).arrayBuffer());
    const values = new Uint32Array(planes.length / width);
    planes.forEach((byte, i) => { values[i % values.length] |= byte << 8 * Math.floor(i / values.length); });
    return values;
  }
  // Rows of three numbers from what each adds to the one before, column by column.
  function summed(steps, rows) {
    for (let k = 0, n = steps.length / 3; k < 3; k++) for (let i = 0, sum = 0; i < n; i++) rows[3 * i + k] = sum += steps[k * n + i];
    return rows;
  }
  async function decode(layer) {
    const places = await unpack(layer.vertices, 2), cells = await unpack(layer.cells, 4), tints = layer.colors && await unpack(layer.colors, 1);
    for (let i = 0, next = 0; i < cells.length; i++) cells[i] = cells[i] ? next - cells[i] : next++;
    return { ...layer, cells, vertices: summed(places, new Uint16Array(places.length)), colors: tints && summed(tints, new Uint8Array(tints.length)) };
  }
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = a => { const l = Math.hypot(...a); return a.map(v => v / l); };

  function button(text, pressed, onclick) {
    const b = document.createElement("button");
    b.type = "button"; b.textContent = text; b.onclick = onclick;
    if (pressed !== null) b.setAttribute("aria-pressed", pressed);
    return b;
  }

  function program(gl) {
    const p = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const s = gl.createShader(kind);
      gl.shaderSource(s, text); gl.compileShader(s);
      if (!gl.getShaderParameter(s, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(s));
      gl.attachShader(p, s);
    }
    gl.bindAttribLocation(p, 0, "position"); gl.bindAttribLocation(p, 1, "color");
    gl.linkProgram(p);
    if (!gl.getProgramParameter(p, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(p));
    return p;
  }

  function upload(gl, layer) {
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    const buffer = (target, data) => { gl.bindBuffer(target, gl.createBuffer()); gl.bufferData(target, data, gl.STATIC_DRAW); };
    buffer(gl.ARRAY_BUFFER, layer.vertices);
    gl.enableVertexAttribArray(0); gl.vertexAttribPointer(0, 3, gl.UNSIGNED_SHORT, true, 0, 0);
    if (layer.colors) {
      buffer(gl.ARRAY_BUFFER, layer.colors);
      gl.enableVertexAttribArray(1); gl.vertexAttribPointer(1, 3, gl.UNSIGNED_BYTE, true, 0, 0);
    }
    buffer(gl.ELEMENT_ARRAY_BUFFER, layer.cells);
    return { ...layer, array, count: layer.cells.length,
      mode: { triangles: gl.TRIANGLES, lines: gl.LINES, points: gl.POINTS }[layer.kind] };
  }

  // Some of the layers' vertices, evenly picked: the camera is fitted to what is there, not to the corners of a box.
  function sample(layers, most = 3000) {
    const points = [];
    for (const l of layers) {
      const n = l.vertices.length / 3, step = Math.max(1, Math.floor(n * layers.length / most));
      for (let i = 0; i < n; i += step) points.push([0, 1, 2].map(k => l.low[k] + l.size * l.vertices[3 * i + k] / 65535));
    }
    return points;
  }

  const middle = values => (Math.min(...values) + Math.max(...values)) / 2;

  async function start(host) {
    const canvas = host.appendChild(document.createElement("canvas"));
    const gl = canvas.getContext("webgl2", { antialias: true, alpha: true, premultipliedAlpha: true });
    if (!gl || !window.DecompressionStream) {
      host.insertAdjacentHTML("beforeend", '<div class="message">The 3D view needs a browser of 2023 or later, with WebGL 2. The rest of the page is whole.</div>');
      return;
    }
    const data = await Promise.all(JSON.parse(host.querySelector("script").textContent).map(decode));
    const shader = program(gl);
    const at = name => gl.getUniformLocation(shader, name);
    const place = Object.fromEntries(["view", "projection", "low", "size", "point", "opacity", "lit"].map(n => [n, at(n)]));
    const layers = data.map(l => upload(gl, l));
    const solid = layers.filter(l => l.kind === "triangles" && l.visible);
    const points = sample(solid.length ? solid : layers);
    const centre = [0, 1, 2].map(k => middle(points.map(p => p[k])));
    const radius = Math.max(0.05, ...points.map(p => Math.hypot(...p.map((v, k) => v - centre[k]))));
    const first = (Number(host.dataset.azimuth) - 180) * Math.PI / 180;
    const home = (rise = 0.62, turn = first) => ({ turn, rise, ...fitting(rise, turn) });

    function axes({ rise, turn }) {
      const back = [Math.cos(rise) * Math.cos(turn), Math.cos(rise) * Math.sin(turn), Math.sin(rise)];
      const right = unit([-Math.sin(turn), Math.cos(turn), 0]);
      return { back, right, up: cross(back, right) };
    }

    // The shorter side of the window sees 45 degrees, so that a phone held upright shows as much as a desktop.
    function focal() {
      const w = host.clientWidth || 1, h = host.clientHeight || 1, half = Math.tan(Math.PI / 8);
      return [Math.min(1, h / w) / half, Math.min(1, w / h) / half];
    }

    // As near as every point is seen between the buttons above and those below, with a little air.
    function fitting(rise, turn) {
      const { back, right, up } = axes({ rise, turn }), [fx, fy] = focal(), h = host.clientHeight || 1;
      // The middle of the window is 0 and its edges are 1: what the buttons leave free above and below.
      const above = 1 - 2 * (bar.offsetTop + bar.offsetHeight) / h, below = 2 * views.offsetTop / h - 1;
      const seen = points.map(p => [right, up, back].map(a => dot(a, p)));
      // Towards the middle of what is seen; again and again, because near points spread further.
      let target = [0, 1, 2].map(k => middle(seen.map(p => p[k]))), distance = radius * 3;
      for (let again = 0; again < 3; again++) {
        const shift = [0, 1].map(k => middle(seen.map(p => (p[k] - target[k]) / (distance - p[2] + target[2]))));
        shift[1] -= (above - below) / 2 / fy;
        target = [target[0] + shift[0] * distance, target[1] + shift[1] * distance, target[2]];
        distance = 1.04 * Math.max(...seen.map(p => p[2] - target[2] + Math.max(Math.abs(p[0] - target[0]) * fx,
          (p[1] - target[1]) * fy / above, (target[1] - p[1]) * fy / below)));
      }
      return { target: [0, 1, 2].map(k => right[k] * target[0] + up[k] * target[1] + back[k] * target[2]), distance };
    }
    const bar = host.appendChild(document.createElement("div"));
    bar.className = "layers";
    for (const name of new Set(layers.map(l => l.name))) {
      const group = layers.filter(l => l.name === name);
      bar.append(button(name, group[0].visible, e => {
        for (const l of group) l.visible = !l.visible;
        e.target.setAttribute("aria-pressed", group[0].visible); redraw();
      }));
    }
    const views = host.appendChild(document.createElement("div"));
    views.className = "views";
    const look = (rise, angle) => () => { camera = home(rise, angle); redraw(); };
    views.append(button("top", null, look(1.5, -Math.PI / 2)), button("side", null, look(0.05, -Math.PI / 2)), button("reset", null, look(0.62, first)));
    let camera = home(), waiting = false;

    function draw() {
      waiting = false;
      const ratio = Math.min(devicePixelRatio || 1, 2), w = host.clientWidth, h = host.clientHeight;
      if (!w || !h) return;
      if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) {
        canvas.width = Math.round(w * ratio); canvas.height = Math.round(h * ratio);
      }
      gl.viewport(0, 0, canvas.width, canvas.height);
      gl.clearColor(0, 0, 0, 0); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      gl.enable(gl.DEPTH_TEST); gl.enable(gl.BLEND); gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
      const { back, right, up } = axes(camera);
      const eye = camera.target.map((v, k) => v + camera.distance * back[k]);
      const view = [right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0,
        -dot(right, eye), -dot(up, eye), -dot(back, eye), 1];
      const [fx, fy] = focal();
      const near = Math.max(camera.distance * 0.02, 0.005), far = camera.distance + radius * 20;
      const projection = [fx, 0, 0, 0, 0, fy, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, 2 * far * near / (near - far), 0];
      gl.useProgram(shader);
      gl.uniformMatrix4fv(place.view, false, view); gl.uniformMatrix4fv(place.projection, false, projection);
      const shown = layers.filter(l => l.visible);
      gl.polygonOffset(1, 1);
      for (const l of [...shown.filter(l => l.opacity >= 1), ...shown.filter(l => l.opacity < 1)]) {
        gl.bindVertexArray(l.array);
        gl.uniform3fv(place.low, l.low); gl.uniform1f(place.size, l.size);
        gl.uniform1f(place.opacity, l.opacity); gl.uniform1f(place.point, 3 * ratio);
        gl.uniform1i(place.lit, l.kind === "triangles" ? 1 : 0);
        if (l.color) gl.vertexAttrib3f(1, ...l.color.map(c => c / 255));
        gl.depthMask(l.opacity >= 1);
        // Solid surfaces lie a little further back, so that lines and transparent layers on them do not flicker.
        if (l.kind === "triangles" && l.opacity >= 1) gl.enable(gl.POLYGON_OFFSET_FILL); else gl.disable(gl.POLYGON_OFFSET_FILL);
        gl.drawElements(l.mode, l.count, gl.UNSIGNED_INT, 0);
      }
      gl.depthMask(true);
    }
    const redraw = () => { if (!waiting) { waiting = true; requestAnimationFrame(draw); } };

    function turn(dx, dy) {
      camera.turn -= dx * 0.008;
      camera.rise = Math.min(1.5, Math.max(-1.5, camera.rise + dy * 0.008));
    }
    function move(dx, dy) {
      const { right, up } = axes(camera), step = camera.distance * 0.83 / Math.min(host.clientHeight, host.clientWidth);
      camera.target = camera.target.map((v, k) => v + step * (dy * up[k] - dx * right[k]));
    }
    function zoom(factor) { camera.distance = Math.min(radius * 12, Math.max(radius * 0.03, camera.distance * factor)); }

    const fingers = new Map();
    canvas.addEventListener("pointerdown", e => { canvas.setPointerCapture(e.pointerId); fingers.set(e.pointerId, [e.clientX, e.clientY]); });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, e => fingers.delete(e.pointerId));
    canvas.addEventListener("pointermove", e => {
      const before = fingers.get(e.pointerId);
      if (!before) return;
      const now = [e.clientX, e.clientY], dx = now[0] - before[0], dy = now[1] - before[1];
      if (fingers.size === 2) {
        const other = [...fingers].find(([id]) => id !== e.pointerId)[1];
        const gap = p => Math.max(1, Math.hypot(p[0] - other[0], p[1] - other[1]));
        zoom(gap(before) / gap(now)); move(dx / 2, dy / 2);
      } else if (e.buttons & 2 || e.shiftKey) move(dx, dy); else turn(dx, dy);
      fingers.set(e.pointerId, now);
      redraw();
    });
    canvas.addEventListener("contextmenu", e => e.preventDefault());
    canvas.addEventListener("wheel", e => { e.preventDefault(); zoom(Math.exp(e.deltaY * 0.001)); redraw(); }, { passive: false });

    new ResizeObserver(redraw).observe(host);
    redraw();
  }

  for (const host of document.querySelectorAll(".viewer3d")) start(host);
})();
