// The reference segmentation in the page: grey, Gaussian blur, strict threshold, dilation by a disk, removal of small blobs.
// Same arithmetic as evanesce.measurement.reference.segment in double precision; a test compares pixel counts.
"use strict";
(() => {
  const frames = JSON.parse(document.getElementById("slider-data").textContent);
  const byId = (name) => document.getElementById("slider-" + name);
  const TRUE = [0, 179, 255], MEASURED = [255, 127, 14];

  // Weights of SciPy's Gaussian, cut at four standard deviations.
  function gaussian(sigma) {
    if (sigma < 1e-15) return [1];
    const reach = Math.floor(4 * sigma + 0.5), taps = [];
    for (let k = -reach; k <= reach; k++) taps.push(Math.exp(-0.5 * (k / sigma) * (k / sigma)));
    const sum = taps.reduce((a, b) => a + b, 0);
    return taps.map((t) => t / sum);
  }

  // Blurred grey level 0 to 1, edges repeated; rows first, as SciPy does.
  function blurred(grey, rows, cols, sigma) {
    const taps = gaussian(sigma), reach = (taps.length - 1) / 2;
    const half = new Float64Array(rows * cols), out = new Float64Array(rows * cols);
    for (let y = 0; y < rows; y++)
      for (let k = -reach; k <= reach; k++) {
        const from = Math.min(rows - 1, Math.max(0, y + k)) * cols, to = y * cols, t = taps[k + reach];
        for (let x = 0; x < cols; x++) half[to + x] += t * grey[from + x];
      }
    for (let y = 0; y < rows; y++)
      for (let x = 0; x < cols; x++) {
        let sum = 0;
        for (let k = -reach; k <= reach; k++)
          sum += taps[k + reach] * half[y * cols + Math.min(cols - 1, Math.max(0, x + k))];
        out[y * cols + x] = sum;
      }
    return out;
  }

  // Distance to the nearest bright pixel of the row, up to radius + 1.
  function rowDistance(bright, rows, cols, radius) {
    const far = radius + 1, found = new Uint8Array(rows * cols);
    for (let y = 0; y < rows; y++) {
      let d = far;
      for (let i = y * cols; i < (y + 1) * cols; i++) found[i] = d = bright[i] ? 0 : Math.min(far, d + 1);
      d = far;
      for (let i = (y + 1) * cols - 1; i >= y * cols; i--) {
        d = bright[i] ? 0 : Math.min(far, d + 1);
        if (d < found[i]) found[i] = d;
      }
    }
    return found;
  }

  function dilated(bright, rows, cols, radius) {
    const near = rowDistance(bright, rows, cols, radius), out = new Uint8Array(rows * cols);
    for (let dy = -radius; dy <= radius; dy++) {
      const wide = Math.floor(Math.sqrt(radius * radius - dy * dy));
      for (let y = Math.max(0, -dy); y < Math.min(rows, rows - dy); y++) {
        const to = y * cols, from = (y + dy) * cols;
        for (let x = 0; x < cols; x++) if (near[from + x] <= wide) out[to + x] = 1;
      }
    }
    return out;
  }

  // Clears dilated blobs (8 neighbours) of fewer than `minimum` pixels.
  function keepLarge(blobs, rows, cols, minimum) {
    const stack = new Int32Array(rows * cols), members = new Int32Array(rows * cols);
    for (let start = 0; start < blobs.length; start++) {
      if (blobs[start] !== 1) continue;
      let height = 0, count = 0;
      stack[height++] = start;
      blobs[start] = 2;
      while (height) {
        const at = stack[--height], y = Math.floor(at / cols), x = at - y * cols;
        members[count++] = at;
        for (let r = Math.max(0, y - 1); r <= Math.min(rows - 1, y + 1); r++)
          for (let c = Math.max(0, x - 1); c <= Math.min(cols - 1, x + 1); c++)
            if (blobs[r * cols + c] === 1) {
              blobs[r * cols + c] = 2;
              stack[height++] = r * cols + c;
            }
      }
      if (count < minimum) for (let k = 0; k < count; k++) blobs[members[k]] = 0;
    }
  }

  function chain(frame, threshold) {
    const { rows, cols, level } = frame, mask = new Uint8Array(rows * cols);
    for (let i = 0; i < mask.length; i++) mask[i] = level[i] > threshold ? 1 : 0;
    const blobs = dilated(mask, rows, cols, frame.radius_px);
    keepLarge(blobs, rows, cols, frame.min_blob_px);
    let pixels = 0;
    for (let i = 0; i < mask.length; i++) pixels += mask[i] = mask[i] && blobs[i] ? 1 : 0;
    return { mask, pixels };
  }

  function onBorder(inside, i, rows, cols) {
    const x = i % cols;
    return inside(i) && (x === 0 || x === cols - 1 || i < cols || i >= (rows - 1) * cols ||
      !inside(i - 1) || !inside(i + 1) || !inside(i - cols) || !inside(i + cols));
  }

  function paint(frame, mask) {
    const { rows, cols, grey, truth } = frame, canvas = byId("picture");
    canvas.width = cols;
    canvas.height = rows;
    const context = canvas.getContext("2d"), picture = context.createImageData(cols, rows), data = picture.data;
    const showMask = byId("mask").checked, showTruth = byId("truth").checked;
    const contact = (i) => truth[i] >= 128;
    for (let i = 0; i < rows * cols; i++) {
      const g = grey[i] * 255;
      let colour = [g, g, g];
      if (showMask && mask[i]) colour = colour.map((v, k) => 0.65 * v + 0.35 * MEASURED[k]);
      data[4 * i] = colour[0]; data[4 * i + 1] = colour[1]; data[4 * i + 2] = colour[2]; data[4 * i + 3] = 255;
    }
    if (showTruth)
      for (let i = 0; i < rows * cols; i++)
        if (onBorder(contact, i, rows, cols))
          for (const j of [i, i + 1, i + cols]) if (j < rows * cols) data.set(TRUE, 4 * j);
    context.putImageData(picture, 0, 0);
  }

  function paintCurve(frame, threshold, error) {
    const canvas = byId("curve"), c = canvas.getContext("2d"), w = canvas.width, h = canvas.height;
    const left = 52, right = 12, top = 12, bottom = 40, low = -100, high = 200;
    const X = (t) => left + t * (w - left - right);
    const Y = (e) => h - bottom - (Math.min(high, Math.max(low, e)) - low) / (high - low) * (h - top - bottom);
    c.clearRect(0, 0, w, h);
    c.font = "12px system-ui, sans-serif"; c.fillStyle = "#424a53"; c.strokeStyle = "#d0d7de"; c.lineWidth = 1;
    for (let e = low; e <= high; e += 50) {
      c.beginPath(); c.moveTo(left, Y(e)); c.lineTo(w - right, Y(e)); c.stroke();
      c.textAlign = "right"; c.fillText(String(e), left - 6, Y(e) + 4);
    }
    c.textAlign = "center";
    for (const t of [0, 0.2, 0.4, 0.6, 0.8, 1]) c.fillText(t.toFixed(1), X(t), h - bottom + 16);
    c.fillText("threshold, grey level 0 to 1", (left + w - right) / 2, h - 6);
    c.save(); c.translate(14, (h - bottom + top) / 2); c.rotate(-Math.PI / 2);
    c.fillText("area error [%]", 0, 0); c.restore();
    c.strokeStyle = "#1f6feb"; c.lineWidth = 2; c.beginPath();
    frame.curve.forEach(([t, e], k) => (k ? c.lineTo(X(t), Y(e)) : c.moveTo(X(t), Y(e))));
    c.stroke();
    c.fillStyle = "rgb(255,127,14)"; c.beginPath(); c.arc(X(threshold), Y(error), 5, 0, 2 * Math.PI); c.fill();
  }

  function show() {
    const frame = frames[Number(byId("frame").value)], threshold = Number(byId("threshold").value);
    const found = chain(frame, threshold), area = found.pixels * frame.mm2_per_px;
    const error = 100 * (area / frame.true_area_mm2 - 1);
    byId("value").textContent = threshold.toFixed(4);
    const result = byId("result");
    result.textContent = `measured ${area.toFixed(2)} mm², true ${frame.true_area_mm2.toFixed(2)} mm²: ` +
      `${error >= 0 ? "+" : "−"}${Math.abs(error).toFixed(1)} %`;
    result.dataset.pixels = found.pixels;
    result.dataset.threshold = threshold;
    paint(frame, found.mask);
    paintCurve(frame, threshold, error);
  }

  let waiting = false;
  function soon() {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; show(); });
  }

  // One channel of a grey PNG.
  async function pixels(uri, cols, rows) {
    const picture = await new Promise((resolve, reject) => {
      const image = new Image();
      image.onload = () => resolve(image);
      image.onerror = () => reject(new Error("a picture cannot be decoded"));
      image.src = uri;
    });
    const canvas = document.createElement("canvas");
    canvas.width = cols;
    canvas.height = rows;
    const context = canvas.getContext("2d", { willReadFrequently: true });
    context.drawImage(picture, 0, 0);
    const data = context.getImageData(0, 0, cols, rows).data, out = new Uint8Array(rows * cols);
    for (let i = 0; i < out.length; i++) out[i] = data[4 * i];
    return out;
  }

  async function start() {
    const asked = new URLSearchParams(location.hash.slice(1));
    for (const [k, frame] of frames.entries()) {
      const image = await pixels(frame.image, frame.cols, frame.rows);
      frame.truth = await pixels(frame.truth, frame.cols, frame.rows);
      frame.grey = Float64Array.from(image, (v) => v * (1 / 255));
      frame.level = blurred(frame.grey, frame.rows, frame.cols, frame.blur_px);
      byId("frame").add(new Option(frame.title, k));
    }
    byId("frame").value = asked.get("frame") ?? "0";
    byId("threshold").value = asked.get("threshold") ?? frames[0].threshold;
    for (const name of ["frame", "threshold", "mask", "truth"]) byId(name).addEventListener("input", soon);
    show();
  }

  start().catch((error) => { byId("result").textContent = `The slider failed: ${error}`; });
})();
