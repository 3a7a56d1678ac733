// Draws without WebGL: ground and shadow with the 2D canvas, the figures pixel by pixel with a depth buffer.

const css = (colour, alpha) => `rgb(${colour.map((channel) => Math.round(255 * channel)).join(" ")} / ${alpha})`;

class CanvasRenderer {
  constructor(canvas, figures) {
    this.name = "canvas2d";
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    if (!this.context) throw new Error("no 2D canvas");
    this.figures = figures;
    this.layer = document.createElement("canvas");
    this.gamma = Uint8ClampedArray.from({ length: 1025 }, (_, i) => Math.round(255 * Math.pow(i / 1024, 1 / 2.2)));
  }

  draw(camera, seconds, theme) {
    const { context, canvas } = this;
    this.camera = camera;
    this.pixels = canvas.height / (2 * Math.tan(FIELD_OF_VIEW / 2));
    context.clearRect(0, 0, canvas.width, canvas.height);
    this.drawGround(camera, theme);
    this.drawShadows(theme);
    this.figures.forEach((figure, number) => this.drawTrail(figure, seconds, theme.accents[number % theme.accents.length]));
    this.drawFigures(theme);
  }

  spot(x, y, z) {
    const p = project(this.camera.matrix, x, y, z);
    if (p.w < 0.1) return null;
    return { x: (0.5 + 0.5 * p.x) * this.canvas.width, y: (0.5 - 0.5 * p.y) * this.canvas.height, w: p.w };
  }

  ball(x, y, z, radius) {
    const spot = this.spot(x, y, z);
    return spot && { ...spot, r: Math.max((radius * this.pixels) / spot.w, 0.4) };
  }

  drawFigures(theme) {
    const capsules = [];
    for (const { current, parts } of this.figures) {
      for (const [start, end, startRadius, endRadius, tint] of parts) {
        const from = this.ball(...current.subarray(3 * start, 3 * start + 3), startRadius);
        const to = this.ball(...current.subarray(3 * end, 3 * end + 3), endRadius);
        if (from && to) capsules.push({ from, to, tint: theme.tints[tint] });
      }
    }
    const { width, height } = this.canvas;
    const edge = (side, sign, limit) => {
      const ends = capsules.flatMap(({ from, to }) => [from, to]).map((ball) => ball[side] + sign * (ball.r + 2));
      return clamp(Math.round(sign < 0 ? Math.min(...ends) : Math.max(...ends)), 0, limit);
    };
    const box = { x: edge("x", -1, width), y: edge("y", -1, height) };
    box.width = edge("x", 1, width) - box.x;
    box.height = edge("y", 1, height) - box.y;
    if (!capsules.length || box.width <= 0 || box.height <= 0) return;
    Object.assign(this.layer, { width: box.width, height: box.height });
    const image = new ImageData(box.width, box.height);
    const depths = new Float32Array(box.width * box.height).fill(-Infinity);
    capsules.sort((a, b) => b.from.w + b.to.w - a.from.w - a.to.w);
    const light = this.lightInView(theme);
    for (const capsule of capsules) this.fillCapsule(capsule, box, image.data, depths, light);
    const layer = this.layer.getContext("2d");
    layer.putImageData(image, 0, 0);
    this.context.drawImage(this.layer, box.x, box.y);
  }

  // Directions and strengths of light in view space: x right, y down like pixels, z towards the camera.
  lightInView(theme) {
    const { right, up } = this.camera;
    const back = cross(right, up);
    const inView = (v) => [dot(v, right), -dot(v, up), dot(v, back)];
    const directions = { key: inView(LIGHT_DIRECTION), fill: inView(FILL_DIRECTION), sky: inView([0, 1, 0]) };
    return { ...directions, ...theme.uniforms };
  }

  // A cone between two balls in parallel projection along z. Each pixel shows the surface in front.
  fillCapsule({ from, to, tint }, box, pixels, depths, light) {
    // Depth is measured in pixels at the limb's distance, so that the limb keeps its proportions.
    const unitDepth = (2 * this.pixels) / (from.w + to.w);
    const [dx, dy, dz] = [to.x - from.x, to.y - from.y, (from.w - to.w) * unitDepth];
    const span = Math.max(Math.hypot(dx, dy, dz), 1e-3);
    const flat = Math.max(Math.hypot(dx, dy), 1e-3);
    const [ux, uy, uz] = [dx / span, dy / span, dz / span];
    const slope = clamp((from.r - to.r) / span, -0.98, 0.98);
    const slope2 = clamp((from.r - to.r) / flat, -0.999, 0.999);
    const cosine2 = 1 - slope * slope;
    const lean2 = slope2 / Math.sqrt(1 - slope2 * slope2);
    const quadratic = 1 - (uz * uz) / cosine2;
    const low = (side) => Math.floor(Math.min(from[side] - from.r, to[side] - to.r) - 1 - box[side]);
    const high = (side) => Math.ceil(Math.max(from[side] + from.r, to[side] + to.r) + 1 - box[side]);
    const [x0, x1] = [Math.max(low("x"), 0), Math.min(high("x"), box.width - 1)];
    const [y0, y1] = [Math.max(low("y"), 0), Math.min(high("y"), box.height - 1)];
    for (let row = y0; row <= y1; row++) {
      for (let column = x0; column <= x1; column++) {
        const x = column + box.x + 0.5 - from.x;
        const y = row + box.y + 0.5 - from.y;
        const along = (x * dx + y * dy) / flat;
        const aside = Math.abs(x * dy - y * dx) / flat;
        const share = clamp((along - aside * lean2) / flat, 0, 1);
        const outline = Math.hypot(x - share * dx, y - share * dy) - (from.r + share * (to.r - from.r));
        if (outline >= 0.5) continue;
        let depth = -Infinity;
        let [nx, ny, nz] = [0, 0, 0];
        const ballDepth = from.r * from.r - x * x - y * y;
        if (ballDepth > 0) {
          depth = Math.sqrt(ballDepth);
          [nx, ny, nz] = [x / from.r, y / from.r, depth / from.r];
        }
        const [ex, ey] = [x - dx, y - dy];
        const endDepth = to.r * to.r - ex * ex - ey * ey;
        if (endDepth > 0 && dz + Math.sqrt(endDepth) > depth) {
          const z = Math.sqrt(endDepth);
          depth = dz + z;
          [nx, ny, nz] = [ex / to.r, ey / to.r, z / to.r];
        }
        if (quadratic > 1e-4) {
          const q = x * ux + y * uy;
          const reach = from.r - slope * q;
          const half = -q * uz + (reach * slope * uz) / cosine2;
          const rest = x * x + y * y - q * q - (reach * reach) / cosine2;
          const z = (-half + Math.sqrt(Math.max(half * half - quadratic * rest, 0))) / quadratic;
          const t = q + z * uz;
          if (t > from.r * slope && t < span + to.r * slope && z > depth) {
            depth = z;
            const radius = Math.max(from.r - slope * t, 1e-3) / cosine2;
            [nx, ny, nz] = [(x - ux * t) / radius + ux * slope, (y - uy * t) / radius + uy * slope, (z - uz * t) / radius + uz * slope];
          }
        }
        if (depth === -Infinity) [depth, nx, ny, nz] = [share * dz, (x - share * dx) / from.r, (y - share * dy) / from.r, 0];
        this.shadePixel(row * box.width + column, depth / unitDepth - from.w, Math.min(0.5 - outline, 1), [nx, ny, nz], tint, pixels, depths, light);
      }
    }
  }

  shadePixel(place, depth, cover, n, tint, pixels, depths, light) {
    if (depth < depths[place] - 0.0005) return;
    const size = 1 / Math.max(Math.hypot(n[0], n[1], n[2]), 1e-3);
    const key = Math.max(dot(n, light.key) * size, 0) * light.keyLight;
    const fill = Math.max(dot(n, light.fill) * size, 0) * light.fillLight;
    const soft = 0.5 + 0.5 * clamp(dot(n, light.sky) * size, -1, 1);
    const rim = Math.pow(1 - clamp(n[2] * size, 0, 1), 4) * 0.1 * soft;
    const behind = pixels[4 * place + 3] / 255;
    const total = cover + behind * (1 - cover);
    for (let channel = 0; channel < 3; channel++) {
      const ambient = light.groundLight[channel] + (light.skyLight[channel] - light.groundLight[channel]) * soft;
      const value = tint[channel] * (0.9 * ambient + fill + key) + rim;
      const shown = this.gamma[Math.round(1024 * clamp(value, 0, 1))];
      pixels[4 * place + channel] = (shown * cover + pixels[4 * place + channel] * behind * (1 - cover)) / total;
    }
    pixels[4 * place + 3] = 255 * total;
    if (cover > 0.5) depths[place] = depth;
  }

  // Adds the outline around two circles to the current path.
  outline(a, b) {
    const { context } = this;
    const distance = Math.hypot(b.x - a.x, b.y - a.y);
    if (distance <= Math.abs(a.r - b.r) + 1e-3) {
      const big = a.r > b.r ? a : b;
      context.moveTo(big.x + big.r, big.y);
      context.arc(big.x, big.y, big.r, 0, 2 * Math.PI);
      return;
    }
    const heading = Math.atan2(b.y - a.y, b.x - a.x);
    const tilt = Math.acos((a.r - b.r) / distance);
    context.moveTo(a.x + a.r * Math.cos(heading + tilt), a.y + a.r * Math.sin(heading + tilt));
    context.arc(a.x, a.y, a.r, heading + tilt, heading - tilt + 2 * Math.PI);
    context.arc(b.x, b.y, b.r, heading - tilt, heading + tilt);
    context.closePath();
  }

  drawShadows(theme) {
    const { context } = this;
    context.save();
    context.filter = `blur(${Math.max(this.canvas.height / 140, 2)}px)`;
    context.fillStyle = `rgb(0 0 0 / ${0.85 * theme.uniforms.shadowStrength})`;
    context.beginPath();
    for (const { current, parts } of this.figures) {
      for (const [start, end, startRadius, endRadius] of parts) {
        const [from, to] = [[start, startRadius], [end, endRadius]].map(([point, radius]) => {
          const [x, y, z] = current.subarray(3 * point, 3 * point + 3);
          const down = Math.max(y, 0) / LIGHT_DIRECTION[1];
          return this.ball(x - down * LIGHT_DIRECTION[0], 0, z - down * LIGHT_DIRECTION[2], 0.75 * radius);
        });
        if (from && to) this.outline(from, to);
      }
    }
    context.fill();
    context.restore();
  }

  line(a, b) {
    const [from, to] = [this.spot(...a), this.spot(...b)];
    if (!from || !to) return;
    this.context.moveTo(from.x, from.y);
    this.context.lineTo(to.x, to.y);
  }

  drawGround({ target, distance }, theme) {
    const { context, canvas } = this;
    const middle = this.spot(target[0], 0, target[2]);
    if (middle) {
      const glow = context.createRadialGradient(middle.x, middle.y, 0, middle.x, middle.y, 0.75 * canvas.width);
      glow.addColorStop(0, css(theme.uniforms.ground, 0.9));
      glow.addColorStop(1, css(theme.uniforms.ground, 0));
      context.fillStyle = glow;
      context.fillRect(0, 0, canvas.width, canvas.height);
    }
    const [x, z] = [Math.round(target[0]), Math.round(target[2])];
    const reach = Math.ceil(Math.min(Math.max(1.6 * distance, 5), 14));
    context.lineWidth = Math.max(canvas.height / 600, 1);
    for (let k = -reach; k <= reach; k++) {
      for (let j = -reach; j < reach; j++) {
        const fade = 1 - Math.hypot(k, j + 0.5) / reach;
        if (fade <= 0) continue;
        context.strokeStyle = css(theme.uniforms.lines, Math.min(1.6 * fade, 1));
        context.beginPath();
        this.line([x + k, 0, z + j], [x + k, 0, z + j + 1]);
        this.line([x + j, 0, z + k], [x + j + 1, 0, z + k]);
        context.stroke();
      }
    }
  }

  drawTrail(figure, seconds, accent) {
    const { context } = this;
    context.lineWidth = Math.max(this.canvas.height / 230, 2);
    context.lineJoin = "round";
    const last = figure.frames - 1;
    const now = Math.min(Math.floor(seconds * figure.fps), last);
    for (const [first, end, strength] of [[0, now, 0.6], [now, last, 0.15]]) {
      context.strokeStyle = css(accent, strength);
      context.beginPath();
      for (let frame = first; frame < end; frame++) {
        const [a, b] = [trailAt(figure, frame), trailAt(figure, frame + 1)];
        this.line([a[0], 0, a[2]], [b[0], 0, b[2]]);
      }
      context.stroke();
    }
  }
}
