// A small picture of a motion for a list, as lines between joints: `window.T2M.drawMiniature`. Only the studio has it.

const POSES = [0.1, 0.5, 0.9]; // shares of the time, from left to right
const SIDE = 0.6;              // radians by which figures are seen from the side
const HEADROOM = 2.1;          // meters that fill the height; higher jumps are drawn smaller

// Returns the path of an SVG element: some poses of a recorded figure, beside each other.
window.T2M.drawMiniature = (record, width, height) => {
  const figure = unpackFigure(record);
  const scale = height / Math.max(HEADROOM, boundsOf(figure).high[1]);
  const lines = POSES.flatMap((share, place) => {
    poseAt(figure, (share * (figure.frames - 1)) / figure.fps);
    const at = (point) => figure.current.subarray(3 * point, 3 * point + 3);
    const [rootX, , rootZ] = at(0);
    const middle = (width * (place + 0.5)) / POSES.length;
    const seen = (point) => {
      const [x, y, z] = at(point);
      const across = Math.cos(SIDE) * (x - rootX) - Math.sin(SIDE) * (z - rootZ);
      return `${(middle + scale * across).toFixed(1)} ${(height - scale * y).toFixed(1)}`;
    };
    return figure.parts.map(([start, end]) => `M${seen(start)}L${seen(end)}`);
  });
  return lines.join("");
};
