// Draws with WebGL 2: capsules as instances of one mesh, a shadow map, the ground and the trails.

const SHADOW_SIZE = 2048;
const LIGHT_DIRECTION = unit([0.42, 1.0, 0.38]);
const FILL_DIRECTION = unit([-0.6, 0.35, -0.7]);

function compile(gl, vertexSource, fragmentSource) {
  const program = gl.createProgram();
  const head = "#version 300 es";
  const insert = [
    head,
    `#define SHADOW_SIZE ${SHADOW_SIZE}.0`,
    `#define SOFTNESS ${(SHADOW_SIZE / 110).toFixed(1)}`,
    `#define FILL_DIRECTION vec3(${FILL_DIRECTION.map((x) => x.toFixed(4))})`,
  ].join("\n");
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertexSource], [gl.FRAGMENT_SHADER, fragmentSource]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source.replace(head, insert));
    gl.compileShader(shader);
    gl.attachShader(program, shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) {
      throw new Error(gl.getShaderInfoLog(shader));
    }
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
    throw new Error(gl.getProgramInfoLog(program));
  }
  const uniforms = {};
  const count = gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS) || 0;
  for (let i = 0; i < count; i++) {
    const { name } = gl.getActiveUniform(program, i);
    uniforms[name] = gl.getUniformLocation(program, name);
  }
  return { program, uniforms };
}

// Rings from the seam to both poles; the strip between the two seams is the cone.
function capsuleMesh(turns, rings) {
  const vertices = [];
  const indices = [];
  const rows = [];
  for (let ring = rings; ring >= 0; ring--) rows.push([ring / rings, 0]);
  for (let ring = 0; ring <= rings; ring++) rows.push([ring / rings, 1]);
  rows.forEach(([place, end]) => {
    for (let turn = 0; turn <= turns; turn++) vertices.push((2 * Math.PI * turn) / turns, place, end);
  });
  for (let row = 0; row + 1 < rows.length; row++) {
    for (let turn = 0; turn < turns; turn++) {
      const a = row * (turns + 1) + turn;
      const b = a + turns + 1;
      indices.push(a, a + 1, b, b, a + 1, b + 1);
    }
  }
  return { vertices: new Float32Array(vertices), indices: new Uint16Array(indices) };
}

// A ribbon along a root path: x, z, seconds for two vertices per frame.
function trailRibbon(figure) {
  const vertices = [];
  let normal = [1, 0];
  for (let frame = 0; frame < figure.frames; frame++) {
    const [before, here, after] = [trailAt(figure, frame - 2), trailAt(figure, frame), trailAt(figure, frame + 2)];
    const [dx, dz] = [after[0] - before[0], after[2] - before[2]];
    const speed = Math.hypot(dx, dz);
    if (speed > 0.01) normal = [-dz / speed, dx / speed];
    for (const side of [-0.013, 0.013]) {
      vertices.push(here[0] + side * normal[0], here[2] + side * normal[1], frame / figure.fps);
    }
  }
  return new Float32Array(vertices);
}

class WebGLRenderer {
  constructor(canvas, figures) {
    // Software WebGL is slower than drawing on a 2D canvas, so it is rejected.
    const wishes = { antialias: true, alpha: true, powerPreference: "low-power", failIfMajorPerformanceCaveat: true };
    const gl = canvas.getContext("webgl2", wishes);
    if (!gl) throw new Error("WebGL 2 is not available");
    this.name = "webgl2";
    this.gl = gl;
    this.figures = figures;
    this.numParts = figures.reduce((sum, figure) => sum + figure.parts.length, 0);
    this.instances = new Float32Array(11 * this.numParts);
    this.build();
  }

  build() {
    const gl = this.gl;
    this.body = compile(gl, CAPSULE_VERTEX, BODY_FRAGMENT);
    this.shadow = compile(gl, CAPSULE_VERTEX, SHADOW_FRAGMENT);
    this.ground = compile(gl, GROUND_VERTEX, GROUND_FRAGMENT);
    this.trail = compile(gl, TRAIL_VERTEX, TRAIL_FRAGMENT);
    this.buildCapsules();
    this.quad = this.array(new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]), 2);
    this.ribbons = this.figures.map((figure) => ({ array: this.array(trailRibbon(figure), 3), count: 2 * figure.frames }));
    this.shadowTexture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.shadowTexture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.DEPTH_COMPONENT24, SHADOW_SIZE, SHADOW_SIZE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_COMPARE_MODE, gl.COMPARE_REF_TO_TEXTURE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    this.shadowFrame = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.shadowFrame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, this.shadowTexture, 0);
    gl.drawBuffers([gl.NONE]);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.bindTexture(gl.TEXTURE_2D, null);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.CULL_FACE);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  array(values, size) {
    const gl = this.gl;
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, size, gl.FLOAT, false, 0, 0);
    return array;
  }

  buildCapsules() {
    const gl = this.gl;
    const mesh = capsuleMesh(28, 8);
    this.capsules = this.array(mesh.vertices, 3);
    this.numIndices = mesh.indices.length;
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, mesh.indices, gl.STATIC_DRAW);
    this.instanceBuffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, this.instanceBuffer);
    gl.bufferData(gl.ARRAY_BUFFER, this.instances.byteLength, gl.DYNAMIC_DRAW);
    [[1, 4, 0], [2, 4, 16], [3, 3, 32]].forEach(([location, size, offset]) => {
      gl.enableVertexAttribArray(location);
      gl.vertexAttribPointer(location, size, gl.FLOAT, false, 44, offset);
      gl.vertexAttribDivisor(location, 1);
    });
    gl.bindVertexArray(null);
  }

  fillInstances(theme) {
    let i = 0;
    for (const { current, parts } of this.figures) {
      for (const [start, end, startRadius, endRadius, tint] of parts) {
        for (const [point, radius] of [[start, startRadius], [end, endRadius]]) {
          for (let axis = 0; axis < 3; axis++) this.instances[i++] = current[3 * point + axis];
          this.instances[i++] = radius;
        }
        for (let channel = 0; channel < 3; channel++) this.instances[i++] = theme.tints[tint][channel];
      }
    }
    const gl = this.gl;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.instanceBuffer);
    gl.bufferSubData(gl.ARRAY_BUFFER, 0, this.instances);
  }

  // The light points at the middle of the figures. Its field is just wide enough for all of them.
  lightMatrix() {
    const roots = this.figures.map(({ current }) => [current[0], current[1], current[2]]);
    const middle = scale(roots.reduce(add), 1 / roots.length);
    const spread = Math.max(...roots.map((root) => Math.hypot(...subtract(root, middle))));
    const size = spread + 1.6;
    const eye = add(middle, scale(LIGHT_DIRECTION, size + 4));
    return multiply(orthographic(size, 0.1, 2 * size + 8), lookAt(eye, middle, [0, 0, 1]));
  }

  use({ program, uniforms }, values) {
    const gl = this.gl;
    gl.useProgram(program);
    for (const [name, value] of Object.entries(values)) {
      const place = uniforms[name];
      if (place === undefined) continue;
      if (name === "shadowMap") gl.uniform1i(place, 0);
      else if (typeof value === "number") gl.uniform1f(place, value);
      else if (value.length === 2) gl.uniform2fv(place, value);
      else if (value.length === 3) gl.uniform3fv(place, value);
      else gl.uniformMatrix4fv(place, false, value);
    }
  }

  drawCapsules() {
    const gl = this.gl;
    gl.bindVertexArray(this.capsules);
    gl.drawElementsInstanced(gl.TRIANGLES, this.numIndices, gl.UNSIGNED_SHORT, 0, this.numParts);
  }

  draw(camera, seconds, theme) {
    const gl = this.gl;
    if (gl.isContextLost()) return;
    this.fillInstances(theme);
    const lightMatrix = this.lightMatrix();
    gl.bindTexture(gl.TEXTURE_2D, null);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.shadowFrame);
    gl.viewport(0, 0, SHADOW_SIZE, SHADOW_SIZE);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    this.use(this.shadow, { matrix: lightMatrix });
    this.drawCapsules();
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.bindTexture(gl.TEXTURE_2D, this.shadowTexture);
    gl.viewport(0, 0, gl.drawingBufferWidth, gl.drawingBufferHeight);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const shared = {
      ...theme.uniforms, matrix: camera.matrix, eye: camera.eye, lightMatrix, lightDirection: LIGHT_DIRECTION,
      shadowMap: 0, centre: [camera.target[0], camera.target[2]], reach: Math.max(2.2 * camera.distance, 7), now: seconds,
    };
    this.drawGround(shared, theme);
    this.use(this.body, shared);
    this.drawCapsules();
    gl.bindVertexArray(null);
  }

  drawGround(shared, theme) {
    const gl = this.gl;
    gl.enable(gl.BLEND);
    gl.disable(gl.CULL_FACE);
    gl.depthMask(false);
    this.use(this.ground, shared);
    gl.bindVertexArray(this.quad);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    this.ribbons.forEach(({ array, count }, number) => {
      this.use(this.trail, { ...shared, accent: theme.accents[number % theme.accents.length] });
      gl.bindVertexArray(array);
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, count);
    });
    gl.depthMask(true);
    gl.enable(gl.CULL_FACE);
    gl.disable(gl.BLEND);
  }
}
