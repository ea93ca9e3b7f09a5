// The viewer's front end: one module for the page of `softras2d view` and for the notebook widget.
//
// It keeps a view (zoom and position), settings and overlays, asks for exact pictures of them, and
// shows the last picture moved and scaled until the exact one arrives. It loads nothing from the
// net. Coordinates: a drawing at zoom 1 has pixels of its own; `view.x, view.y` is the pixel of the
// enlarged drawing at the upper left of the canvas; a canvas pixel covers `pixelSize` screen pixels.

const SAMPLES = [1, 4, 9, 16, 64];
const ANISOTROPIES = [1, 2, 4, 8, 16];
const PIXEL_SIZES = [1, 2, 4, 8, 16, 32];
const MOST_SIDE = 65536; // Coordinates in float32 are too coarse beyond.
const ZOOM_STEP = 1.25;
const CANVAS_STEP = 32; // Canvas sides are multiples of this many screen pixels.
const MOST_CANVAS = 8192;
const DIFFERENCE_GAIN = 4;
const NARROW = 900; // A viewer of at most this width, in CSS pixels, starts without its panel.
const BLOCK = 16; // Pixels of a block of a packed picture.
const BUSY_MS = 150; // A picture that takes longer is announced.
const ARROW_PIXELS = 48; // Length of the longest gradient, in screen pixels.

const DEFAULTS = {
  coverage: "sampled",
  samples: 16,
  fill_rule: "inclusive",
  shading: "sample",
  soft_width: 1,
  pixel_filter: "bilinear",
  level_filter: "linear",
  anisotropy: 1,
  lod_bias: 0,
};

// Settings that a picture can be compared with, beside other files and pinned settings.
const COMPARISONS = {
  "1 sample": { coverage: "sampled", samples: 1 },
  "4 samples": { coverage: "sampled", samples: 4 },
  "64 samples": { coverage: "sampled", samples: 64 },
  "area coverage": { coverage: "area" },
  "soft edges": { coverage: "soft" },
  "nearest texels": { pixel_filter: "nearest", level_filter: "zero" },
  trilinear: { pixel_filter: "bilinear", level_filter: "linear" },
  "top-left rule": { coverage: "sampled", fill_rule: "top_left" },
  "pixel shading": { coverage: "sampled", shading: "pixel" },
};

const COVERAGE_NOTES = {
  sampled: "",
  soft: "Triangles fade across their edges, so that the background shows at the seams of adjacent ones.",
  area: "Each triangle covers its exact area of a pixel and is blended over those behind, so that the " +
    "background shows at the seams of adjacent triangles. The inspector shows the exact value.",
};

// Keys, what they do, and the method to call. The first ones, down to the space bar, are those of
// the rasterizer course's viewer.
const KEYS = [
  ["-", "fewer samples", (v) => v.stepSetting("samples", SAMPLES, -1)],
  ["=", "more samples", (v) => v.stepSetting("samples", SAMPLES, 1)],
  ["z", "pixel inspector", (v) => v.toggleInspector()],
  ["p", "pixel filter of textures", (v) => v.cycle("pixel_filter", ["nearest", "bilinear"])],
  ["l", "level filter of textures", (v) => v.cycle("level_filter", ["zero", "nearest", "linear"])],
  [" ", "fit the drawing", (v) => v.fit()],
  ["s", "save as PNG", (v) => v.save()],
  ["1-9", "show this file", null],
  ["0", "one to one", (v) => v.oneToOne()],
  ["i", "zoom in", (v) => v.zoomBy(ZOOM_STEP)],
  ["o", "zoom out", (v) => v.zoomBy(1 / ZOOM_STEP)],
  ["arrows", "pan, or move the inspector", null],
  ["r", "larger pixels", (v) => v.stepPixelSize(1)],
  ["R", "smaller pixels", (v) => v.stepPixelSize(-1)],
  ["c", "sampled, soft, area", (v) => v.cycle("coverage", ["sampled", "soft", "area"])],
  ["w", "wider soft edges", (v) => v.scaleWidth(1.25)],
  ["W", "narrower soft edges", (v) => v.scaleWidth(0.8)],
  ["f", "fill rule", (v) => v.cycle("fill_rule", ["inclusive", "top_left"])],
  ["m", "shade samples or pixels", (v) => v.cycle("shading", ["sample", "pixel"])],
  ["a", "anisotropy", (v) => v.stepSetting("anisotropy", ANISOTROPIES, 1, true)],
  ["b", "higher level bias", (v) => v.shiftBias(0.25)],
  ["B", "lower level bias", (v) => v.shiftBias(-0.25)],
  ["v", "compare, with a slider", (v) => v.toggleCompare("slider")],
  ["d", "compare, as difference", (v) => v.toggleCompare("difference")],
  ["y", "pin these settings", (v) => v.pin()],
  ["e", "triangle edges", (v) => v.toggleOverlay("edges")],
  ["t", "tiles", (v) => v.toggleOverlay("tiles")],
  ["g", "gradients", (v) => v.toggleOverlay("gradients")],
  ["n", "next file", (v) => v.showSubject(v.current + 1)],
  ["N", "previous file", (v) => v.showSubject(v.current - 1)],
  ["k", "copy the command", (v) => v.copyCommand()],
  ["h", "hide the panel", (v) => v.togglePanel()],
  ["Escape", "close what is open", (v) => v.escape()],
  ["?", "this list", (v) => v.showHelp()],
];

// Transports: `send(request)`, and a handler of (header, DataView of the payload) to set.

export function openSocket(url) {
  const transport = { onmessage: () => {}, onclose: () => {} };
  const waiting = [];
  const socket = new WebSocket(url);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => waiting.splice(0).forEach((text) => socket.send(text));
  socket.onclose = () => transport.onclose();
  socket.onmessage = ({ data }) => {
    const length = new DataView(data).getUint32(0, true);
    const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
    transport.onmessage(header, new DataView(data, 4 + length));
  };
  transport.send = (request) => {
    const text = JSON.stringify(request);
    if (socket.readyState === WebSocket.CONNECTING) waiting.push(text);
    else if (socket.readyState === WebSocket.OPEN) socket.send(text);
  };
  transport.close = () => socket.close();
  return transport;
}

function openModel(model) {
  // `crypto.randomUUID` exists only in secure contexts, and notebooks are also served over HTTP.
  const owner = crypto.getRandomValues(new Uint32Array(4)).join("-");
  const transport = { onmessage: () => {}, onclose: () => {} };
  const receive = (content, buffers) => {
    if (content.owner && content.owner !== owner) return;
    transport.onmessage(content, buffers?.[0] ?? new DataView(new ArrayBuffer(0)));
  };
  model.on("msg:custom", receive);
  transport.send = (request) => {
    try {
      model.send({ ...request, owner });
    } catch {
      transport.onclose();
    }
  };
  transport.close = () => {
    transport.send({ kind: "closed" });
    model.off("msg:custom", receive);
  };
  return transport;
}

// The RGBA of a picture, unpacked as `packed_pixels.py` says.
function unpackPixels({ width, height, blocks, colors }, payload) {
  const { buffer, byteOffset, byteLength } = payload;
  if (blocks === undefined) return new Uint8ClampedArray(buffer, byteOffset, byteLength);
  // A copy, because words must begin at a multiple of 4 bytes.
  const bytes = buffer.slice(byteOffset, byteOffset + byteLength);
  const bitBytes = 4 * Math.ceil(blocks / 32);
  const bits = new Uint8Array(bytes, 0, bitBytes);
  const words = new Uint32Array(bytes, bitBytes);
  const pixels = new Uint32Array(width * height);
  const hasOneColor = (block) => (bits[block >> 3] >> (block & 7)) & 1;
  let [block, color, other] = [0, 0, colors];
  while (block < blocks) {
    const start = block;
    if (hasOneColor(block)) {
      const value = words[color];
      do {
        block++;
        color++;
      } while (block < blocks && hasOneColor(block) && words[color] === value);
      pixels.fill(value, start * BLOCK, block * BLOCK);
    } else {
      do block++;
      while (block < blocks && !hasOneColor(block));
      const length = (block - start) * BLOCK;
      pixels.set(words.subarray(other, other + length), start * BLOCK);
      other += length;
    }
  }
  pixels.set(words.subarray(other), blocks * BLOCK);
  return new Uint8ClampedArray(pixels.buffer);
}

// Elements: h("div", {class: "x", onclick: f}, children...).

function h(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    // The content security policy forbids the attribute, and allows the property.
    else if (name === "style") Object.assign(element.style, value);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value != null) element.setAttribute(name, value);
  }
  // JupyterLab leaves the keys of such an element alone; it looks at the focused element first.
  if (/^(button|input|select|summary)$/.test(tag) || "tabindex" in properties) {
    element.setAttribute("data-lm-suppress-shortcuts", "true");
  }
  element.append(...children);
  return element;
}

const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
const copyOf = (view) => ({ ...view });
const sameView = (a, b) => a && b && ["zoom", "x", "y", "height", "width"].every((k) => a[k] === b[k]);
const percent = (zoom) => `${+(100 * zoom).toPrecision(3)} %`;
const css = ([r, g, b, a = 1]) =>
  `rgb(${[r, g, b].map((v) => Math.round(255 * clamp(v, 0, 1))).join(" ")} / ${a})`;
let names = 0;

class Viewer {
  constructor(root, transport, { isWidget = false, still = "" } = {}) {
    this.root = root;
    this.transport = transport;
    this.isWidget = isWidget;
    this.subjects = [];
    this.current = 0;
    this.settings = { ...DEFAULTS };
    this.pinned = null;
    this.comparison = { mode: "off", against: "1 sample", split: 0.5 };
    this.overlays = { edges: false, tiles: false, gradients: false };
    this.pixelSize = 1;
    this.view = null;
    this.pictures = {}; // By slot "a" or "b": {canvas, rgba, view, header, id}
    this.wanted = {}; // By slot: the id of the last request
    this.overlayData = {}; // By kind: {view, header, values}
    this.lens = { isOn: false, isLocked: false, column: 0, row: 0, report: null };
    this.costs = new Map();
    this.nextId = 1;
    this.isScheduled = false;
    this.askedAt = 0;
    this.error = "";
    this.name = `sr${++names}`;
    this.build(still);
    transport.onmessage = (header, payload) => this.receive(header, payload);
    transport.onclose = () => this.onClosed();
    this.ask("subjects");
  }

  // Building the page.

  build(still) {
    const { root } = this;
    root.classList.add("sr-viewer");
    root.classList.toggle("sr-widget", this.isWidget);
    this.picture = h("canvas", { class: "sr-picture", width: 1, height: 1 });
    this.overlay = h("canvas", { class: "sr-overlay", width: 1, height: 1 });
    this.still = h("img", { class: "sr-still", alt: "", src: still || null, hidden: !still });
    this.split = h("input", {
      type: "range", min: 0, max: 1, step: "any", value: 0.5, "aria-label": "Comparison slider",
      oninput: () => this.moveSplit(+this.split.value),
    });
    this.sideNames = [h("span", { class: "sr-side-name" }), h("span", { class: "sr-side-name" })];
    this.slider = h("div", { class: "sr-slider", hidden: true }, this.split);
    this.stage = h(
      "div",
      {
        class: "sr-stage", tabindex: 0, role: "application",
        "aria-label": "Picture. Drag to pan, scroll to zoom; press ? for the keys.",
      },
      this.still, this.picture, this.overlay, this.slider, ...this.sideNames, (this.bar = this.buildBar()),
    );
    this.fitCard = h("div", { class: "sr-card sr-fit", hidden: true });
    this.toast = h("div", { class: "sr-toast", role: "status", hidden: true });
    this.stage.append(this.fitCard, this.buildLens(), this.toast);
    this.panel = this.buildPanel();
    this.help = this.buildHelp();
    root.append(this.stage, this.panel, this.buildStatus(), this.help);
    this.context = this.picture.getContext("2d", { willReadFrequently: false });
    this.listen();
    this.updateControls();
    this.updateStatus();
  }

  buildBar() {
    const button = (text, title, onclick) => h("button", { type: "button", title, onclick }, text);
    this.subjectChoice = h("select", {
      "aria-label": "File", onchange: () => this.showSubject(+this.subjectChoice.value),
    });
    this.files = h("div", { class: "sr-group", hidden: true }, this.subjectChoice);
    this.pixelChoice = h(
      "select",
      {
        "aria-label": "Screen pixels per pixel of the picture", title: "Pixel size (r, R)",
        onchange: () => this.setPixelSize(+this.pixelChoice.value),
      },
      ...PIXEL_SIZES.map((size) => h("option", { value: size }, `pixels × ${size}`)),
    );
    this.inspectButton = button("Inspect", "Pixel inspector (z)", () => this.isReady() && this.toggleInspector());
    this.compareButton = button("Compare", "Compare (v)", () => this.toggleCompare("slider"));
    this.panelButton = button("Panel", "Show or hide the panel (h)", () => this.togglePanel());
    return h(
      "div",
      { class: "sr-bar", role: "toolbar", "aria-label": "View" },
      this.files,
      h(
        "div", { class: "sr-group" },
        button("−", "Zoom out (o)", () => this.zoomBy(1 / ZOOM_STEP)),
        button("Fit", "Fit the drawing (space)", () => this.fit()),
        button("1:1", "One to one (0)", () => this.oneToOne()),
        button("+", "Zoom in (i)", () => this.zoomBy(ZOOM_STEP)),
      ),
      h("div", { class: "sr-group" }, this.pixelChoice),
      h("div", { class: "sr-space" }),
      h("div", { class: "sr-group" }, this.inspectButton, this.compareButton),
      h(
        "div", { class: "sr-group" },
        button("Save", "Save as PNG (s)", () => this.save()),
        button("Copy", "Copy the command that draws this (k)", () => this.copyCommand()),
      ),
      h(
        "div", { class: "sr-group" },
        button("?", "Keys (?)", () => this.showHelp()),
        this.panelButton,
      ),
    );
  }

  buildPanel() {
    const set = (name) => (value) => this.set(name, value);
    this.controls = {};
    const panel = h("aside", { class: "sr-panel", "aria-label": "Settings" });
    let section = panel;
    // Sections that apply to drawings alone are hidden while an image is shown.
    const begin = (text, isOfDrawings) => {
      const style = isOfDrawings ? "sr-of-drawings" : null;
      section = panel.appendChild(h("section", { class: style }, h("h2", {}, text)));
      return section;
    };
    const choices = (name, label, options, onchange) => {
      const inputs = options.map(([value, text]) => {
        const input = h("input", {
          type: "radio", name: `${this.name}-${name}`, value, "aria-label": `${label}: ${text}`,
          onchange: () => onchange(value),
        });
        return h("label", {}, input, h("span", {}, text));
      });
      const field = h(
        "fieldset", { class: "sr-field" }, h("legend", {}, label),
        h("div", { class: "sr-choices" }, ...inputs),
      );
      this.controls[name] = field;
      section.append(field);
    };
    const range = (name, label, minimum, maximum, step, toText, fromValue, toValue) => {
      const output = h("output");
      const input = h("input", {
        type: "range", min: minimum, max: maximum, step, "aria-label": label,
        oninput: () => this.set(name, fromValue(+input.value)),
      });
      const field = h("div", { class: "sr-field" }, h("div", { class: "sr-label" }, label, output), input);
      this.controls[name] = field;
      field.show = (value) => {
        input.value = toValue(value);
        output.textContent = toText(value);
      };
      section.append(field);
    };
    begin("Coverage", true);
    const kinds = [["sampled", "sampled"], ["soft", "soft"], ["area", "area"]];
    choices("coverage", "Kind", kinds, set("coverage"));
    this.coverageNote = section.appendChild(h("p", { class: "sr-hint", hidden: true }));
    choices("samples", "Samples per pixel", SAMPLES.map((n) => [n, `${n}`]), set("samples"));
    range("soft_width", "Width of soft edges", Math.log(0.1), Math.log(8), 0.01,
      (value) => `${+value.toPrecision(2)} px`, (t) => +Math.exp(t).toPrecision(3), Math.log);
    choices("fill_rule", "Fill rule", [["inclusive", "inclusive"], ["top_left", "top-left"]],
      set("fill_rule"));
    choices("shading", "Shading", [["sample", "per sample"], ["pixel", "per pixel"]], set("shading"));
    this.textureSection = begin("Textures", true);
    choices("pixel_filter", "Within a level", [["nearest", "nearest"], ["bilinear", "bilinear"]],
      set("pixel_filter"));
    choices("level_filter", "Between levels",
      [["zero", "zero"], ["nearest", "nearest"], ["linear", "linear"]], set("level_filter"));
    choices("anisotropy", "Anisotropy", ANISOTROPIES.map((n) => [n, `${n}`]), set("anisotropy"));
    range("lod_bias", "Level bias", -4, 4, 0.25, (value) => `${value}`, (t) => t, (value) => value);
    begin("Overlays", true);
    for (const [name, text] of [["edges", "Triangle edges"], ["tiles", "Tiles, and how full"],
      ["gradients", "Gradients by positions"]]) {
      const input = h("input", { type: "checkbox", onchange: () => this.toggleOverlay(name) });
      this.controls[name] = h("label", { class: "sr-check" }, input, text);
      section.append(this.controls[name]);
    }
    this.overlayNote = section.appendChild(h("p", { class: "sr-hint", hidden: true }));
    begin("Compare", false);
    choices("mode", "Show", [["off", "off"], ["slider", "slider"], ["difference", "difference"]],
      (mode) => this.setCompare({ mode }));
    this.againstChoice = h("select", {
      "aria-label": "Compare with", onchange: () => this.setCompare({ against: this.againstChoice.value }),
    });
    section.append(h("div", { class: "sr-field" }, h("div", { class: "sr-label" }, "With"), this.againstChoice));
    this.differenceNote = section.appendChild(h("p", { class: "sr-hint", hidden: true }));
    begin("Effects", true);
    this.effects = section.appendChild(h("ul", { class: "sr-effects" }));
    this.measureButton = section.appendChild(
      h("button", { type: "button", class: "sr-wide", onclick: () => this.measure() }, "Measure what each costs"),
    );
    this.plan = h("pre");
    section.append(h("details", {}, h("summary", {}, "Plan"), this.plan));
    return panel;
  }

  buildLens() {
    this.lensCanvas = h("canvas", { width: 396, height: 396, style: { width: "198px", height: "198px" } });
    this.pixelCanvas = h("canvas", { width: 272, height: 272, style: { width: "136px", height: "136px" } });
    this.lensTitle = h("h3");
    this.lensValues = h("div", { class: "sr-values" });
    this.lensTable = h("div");
    this.lensCard = h(
      "div", { class: "sr-card sr-lens", hidden: true, role: "region", "aria-label": "Pixel inspector" },
      h(
        "div", { class: "sr-lens-pictures" }, this.lensCanvas,
        h("div", { class: "sr-lens-facts" }, this.pixelCanvas, this.lensTitle),
      ),
      this.lensValues, this.lensTable,
    );
    return this.lensCard;
  }

  buildStatus() {
    this.statusParts = {};
    const part = (name, optional) => {
      this.statusParts[name] = h("span", { class: optional ? "sr-optional" : "" });
      return this.statusParts[name];
    };
    return h(
      "footer", { class: "sr-status" }, part("coverage"), part("size"), part("zoom"),
      part("position", true), h("span", { class: "sr-space" }), part("notes"), part("time"),
    );
  }

  buildHelp() {
    const rows = KEYS.flatMap(([key, text]) => [
      h("dt", {}, h("kbd", {}, key === " " ? "space" : key)), h("dd", {}, text),
    ]);
    const dialog = h(
      "dialog", { class: "sr-help", "aria-label": "Keys" },
      h("h2", {}, "Keys"), h("dl", {}, ...rows),
      h("p", { class: "sr-hint" },
        "Drag to pan, scroll or pinch to zoom, click to hold the inspector at a pixel."),
      h("button", { type: "button", class: "sr-wide", onclick: () => dialog.close() }, "Close"),
    );
    dialog.addEventListener("close", () => this.stage.focus());
    return dialog;
  }

  // Input.

  listen() {
    const target = this.isWidget ? this.root : document;
    this.onKey = (event) => this.pressKey(event);
    target.addEventListener("keydown", this.onKey);
    this.resizing = new ResizeObserver(() => {
      clearTimeout(this.resizeTimer);
      this.resizeTimer = setTimeout(() => this.resize(), this.view ? 160 : 0);
    });
    this.resizing.observe(this.stage);
    const { stage } = this;
    stage.addEventListener("wheel", (event) => this.scroll(event), { passive: false });
    stage.addEventListener("pointerdown", (event) => this.press(event));
    stage.addEventListener("pointermove", (event) => this.move(event));
    stage.addEventListener("pointerup", (event) => this.release(event));
    stage.addEventListener("pointercancel", (event) => this.release(event));
    stage.addEventListener("dblclick", (event) => {
      if (this.isOnPicture(event) && !this.lens.isOn) this.zoomBy(2, this.pointOf(event));
    });
    this.pointers = new Map();
  }

  pressKey(event) {
    const field = event.target;
    if (event.ctrlKey || event.metaKey || event.altKey || this.help.open) return;
    if (field.tagName === "SELECT" || (field.tagName === "INPUT" && field.type === "text")) return;
    const isControl = field !== this.stage && /^(INPUT|BUTTON|SUMMARY)$/.test(field.tagName);
    if (isControl && /^( |Enter|Arrow.*)$/.test(event.key)) return;
    const arrow = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    const digit = /^[1-9]$/.test(event.key);
    if (!this.isReady() && !["?", "h"].includes(event.key)) return;
    const row = KEYS.find(([key, , act]) => act && key === event.key) ??
      (event.key === "+" ? KEYS.find(([key]) => key === "=") : undefined);
    if (arrow) this.pressArrow(arrow, event.shiftKey);
    else if (digit) this.showSubject(+event.key - 1);
    else if (row) row[2](this);
    else return;
    event.preventDefault();
    event.stopPropagation();
  }

  pressArrow([x, y], isFast) {
    if (this.lens.isOn) {
      this.lens.isLocked = true;
      const step = isFast ? 10 : 1;
      this.lookAt(this.lens.column + x * step, this.lens.row + y * step);
    } else {
      const step = (isFast ? 256 : 64) / this.pixelSize;
      this.panBy(-x * step, -y * step);
    }
  }

  // Canvas coordinates of a pointer.
  pointOf(event) {
    const box = this.stage.getBoundingClientRect();
    const scale = this.screenScale();
    return [
      (event.clientX - box.left - this.margin[0]) * scale,
      (event.clientY - box.top - this.margin[1]) * scale,
    ];
  }

  // Canvas pixels for one CSS pixel.
  screenScale() {
    return (window.devicePixelRatio || 1) / this.pixelSize;
  }

  isOnPicture(event) {
    return [this.stage, this.picture, this.overlay].includes(event.target);
  }

  scroll(event) {
    // In a notebook, scrolling past a widget must not zoom it.
    if (this.isWidget && !this.root.contains(document.activeElement) && !event.ctrlKey) return;
    if (event.target.closest(".sr-lens.sr-locked") || !this.isReady()) return;
    event.preventDefault();
    const lines = event.deltaMode === 1 ? 16 : 1;
    const speed = event.ctrlKey ? 0.01 : 0.0015;
    this.zoomBy(Math.exp(-clamp(event.deltaY * lines, -400, 400) * speed), this.pointOf(event));
  }

  press(event) {
    if (!this.isOnPicture(event) || event.button !== 0 || !this.isReady()) return;
    this.stage.focus({ preventScroll: true });
    this.stage.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    this.dragged = 0;
    this.remainder = [0, 0];
  }

  move(event) {
    if (!this.isReady()) return;
    const before = this.pointers.get(event.pointerId);
    if (!before) {
      if (this.lens.isOn && !this.lens.isLocked && this.isOnPicture(event)) {
        this.lookAt(...this.pointOf(event).map(Math.floor));
      }
      return;
    }
    const delta = [event.clientX - before[0], event.clientY - before[1]];
    const other = [...this.pointers].find(([id]) => id !== event.pointerId);
    if (other) {
      const [x, y] = other[1];
      const ratio = Math.hypot(event.clientX - x, event.clientY - y) /
        Math.max(1, Math.hypot(before[0] - x, before[1] - y));
      this.zoomBy(ratio, this.pointOf({ clientX: (event.clientX + x) / 2, clientY: (event.clientY + y) / 2 }));
    } else {
      // Whole canvas pixels only: what is left over is kept for the next move.
      const scale = this.screenScale();
      const wanted = delta.map((d, axis) => d * scale + this.remainder[axis]);
      const whole = wanted.map(Math.round);
      this.remainder = wanted.map((d, axis) => d - whole[axis]);
      if (whole[0] || whole[1]) this.panBy(...whole);
    }
    this.dragged += Math.abs(delta[0]) + Math.abs(delta[1]);
    this.stage.classList.toggle("sr-dragging", this.dragged > 3);
    this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
  }

  release(event) {
    if (!this.pointers.delete(event.pointerId)) return;
    this.stage.classList.remove("sr-dragging");
    if (event.type === "pointerup" && this.dragged <= 3 && this.lens.isOn) {
      this.lens.isLocked = !this.lens.isLocked;
      this.lookAt(...this.pointOf(event).map(Math.floor));
    }
  }

  // The view.

  // Whether there is something to show, and a canvas to show it on.
  isReady() {
    return Boolean(this.view && this.subjects.length);
  }

  subject() {
    return this.subjects[this.current];
  }

  // Sizes the canvas to the stage, and keeps the middle of the view where it is.
  resize() {
    const box = this.stage.getBoundingClientRect();
    const ratio = window.devicePixelRatio || 1;
    if (box.width < 40 || box.height < 40) return;
    // In a narrow window the picture comes first; the panel opens with its button.
    if (!this.view && !this.panel.hidden && this.root.clientWidth <= NARROW) this.togglePanel();
    // In whole steps, so that a window that grows needs few programs; the stage cuts off the rest.
    const step = Math.max(2, CANVAS_STEP / this.pixelSize);
    const side = (length) =>
      clamp(Math.ceil((length * ratio) / this.pixelSize / step) * step, step, MOST_CANVAS / 2);
    const [width, height] = [side(box.width), side(box.height)];
    this.margin = [
      Math.floor(((box.width * ratio - width * this.pixelSize) / 2)) / ratio,
      Math.floor(((box.height * ratio - height * this.pixelSize) / 2)) / ratio,
    ];
    for (const canvas of [this.picture, this.overlay]) {
      canvas.style.left = `${this.margin[0]}px`;
      canvas.style.top = `${this.margin[1]}px`;
      canvas.style.width = `${(width * this.pixelSize) / ratio}px`;
      canvas.style.height = `${(height * this.pixelSize) / ratio}px`;
    }
    this.slider.style.left = `${this.margin[0]}px`;
    this.slider.style.width = this.picture.style.width;
    this.overlay.width = width * this.pixelSize;
    this.overlay.height = height * this.pixelSize;
    const { view } = this;
    if (view && view.width === width && view.height === height) return this.schedule();
    this.picture.width = width;
    this.picture.height = height;
    if (!view || this.isFitted || !this.subjects.length) {
      this.view = { zoom: 1, x: 0, y: 0, height, width };
      this.fit();
    } else {
      this.changeView({
        ...view, height, width,
        x: Math.round(view.x + (view.width - width) / 2),
        y: Math.round(view.y + (view.height - height) / 2),
      });
    }
  }

  changeView(view) {
    const { height, width } = this.subject();
    const longest = Math.max(height, width);
    view.zoom = clamp(view.zoom, 4 / longest, MOST_SIDE / longest);
    view.x = clamp(Math.round(view.x), -1e6, 1e6);
    view.y = clamp(Math.round(view.y), -1e6, 1e6);
    this.view = view;
    this.lens.column = clamp(this.lens.column, 0, view.width - 1);
    this.lens.row = clamp(this.lens.row, 0, view.height - 1);
    this.isFitted = false;
    this.schedule();
  }

  // Shows the whole drawing, below the bar and above what compares.
  fit() {
    if (!this.isReady()) return;
    const { height, width } = this.subject();
    const { view } = this;
    const scale = this.screenScale();
    const top = (this.bar.offsetTop + this.bar.offsetHeight + 8 - this.margin[1]) * scale;
    const available = [
      (this.stage.clientWidth - 24) * scale, (this.stage.clientHeight - this.margin[1] - 12) * scale - top,
    ];
    const zoom = Math.max(Math.min(available[0] / width, available[1] / height), 4 / Math.max(height, width));
    this.changeView({
      ...view, zoom,
      x: Math.round((width * zoom - view.width) / 2),
      y: Math.round((height * zoom - available[1]) / 2 - top),
    });
    this.isFitted = true;
  }

  oneToOne() {
    if (this.isReady()) this.zoomBy(1 / this.view.zoom);
  }

  // Zooms about a point of the canvas, or about its middle.
  zoomBy(factor, point) {
    if (!this.isReady()) return;
    const { view } = this;
    const [px, py] = point ?? [view.width / 2, view.height / 2];
    const { height, width } = this.subject();
    const longest = Math.max(height, width);
    const zoom = clamp(view.zoom * factor, 4 / longest, MOST_SIDE / longest);
    const scale = zoom / view.zoom;
    this.changeView({ ...view, zoom, x: (view.x + px) * scale - px, y: (view.y + py) * scale - py });
  }

  panBy(x, y) {
    this.changeView({ ...this.view, x: this.view.x - x, y: this.view.y - y });
  }

  stepPixelSize(step) {
    const at = clamp(PIXEL_SIZES.indexOf(this.pixelSize) + step, 0, PIXEL_SIZES.length - 1);
    this.setPixelSize(PIXEL_SIZES[at]);
  }

  // Larger pixels of a smaller picture: the drawing keeps its size on the screen.
  setPixelSize(size) {
    if (size === this.pixelSize || !this.isReady()) return;
    const { view } = this;
    const middle = [view.x + view.width / 2, view.y + view.height / 2];
    const scale = this.pixelSize / size;
    this.pixelSize = size;
    this.view = {
      ...view, zoom: view.zoom * scale,
      x: Math.round(middle[0] * scale - view.width / 2),
      y: Math.round(middle[1] * scale - view.height / 2),
    };
    this.resize();
    this.updateControls();
  }

  showSubject(number) {
    const count = this.subjects.length;
    if (!count || number < 0 || number >= count || number === this.current) return;
    this.current = number;
    this.cancelCosts();
    this.overlayData = {};
    this.pictures = {};
    this.wanted = {};
    this.hideReport();
    this.fit();
    this.updateControls();
    this.updateFit();
  }

  // Settings.

  set(name, value) {
    this.settings = { ...this.settings, [name]: value };
    this.cancelCosts();
    this.updateControls();
    this.schedule();
  }

  cycle(name, values) {
    this.set(name, values[(values.indexOf(this.settings[name]) + 1) % values.length]);
  }

  stepSetting(name, values, step, wraps = false) {
    const at = values.indexOf(this.settings[name]) + step;
    if (wraps) this.set(name, values[(at + values.length) % values.length]);
    else if (values[at] !== undefined) this.set(name, values[at]);
  }

  scaleWidth(factor) {
    this.set("soft_width", +clamp(this.settings.soft_width * factor, 0.1, 8).toPrecision(3));
  }

  shiftBias(step) {
    this.set("lod_bias", clamp(this.settings.lod_bias + step, -4, 4));
  }

  toggleOverlay(name) {
    this.overlays[name] = !this.overlays[name];
    if (name === "gradients" && this.overlays.gradients && this.target() === null) {
      this.overlays.gradients = false;
      this.say("Gradients need an image to compare with: name one on the command line.");
    }
    this.updateControls();
    this.schedule();
  }

  // The number of the image that gradients are taken against.
  target() {
    const chosen = /^file (\d+)$/.exec(this.comparison.against);
    if (chosen && this.subjects[chosen[1]]?.is_image) return +chosen[1];
    const first = this.subjects.findIndex((subject) => subject.is_image);
    return first < 0 ? null : first;
  }

  toggleCompare(mode) {
    this.setCompare({ mode: this.comparison.mode === mode ? "off" : mode });
  }

  setCompare(change) {
    this.comparison = { ...this.comparison, ...change };
    if (change.against && this.comparison.mode === "off") this.comparison.mode = "slider";
    delete this.pictures.b;
    // The same picture is requested again, even if only the mode changes.
    delete this.wanted.b;
    this.updateControls();
    this.schedule();
  }

  pin() {
    this.pinned = { ...this.settings };
    this.updateControls();
    this.setCompare({ against: "pinned", mode: this.comparison.mode });
    this.say("Pinned these settings, to compare others with.");
  }

  moveSplit(split) {
    this.comparison.split = split;
    this.paint();
  }

  togglePanel() {
    this.panel.hidden = !this.panel.hidden;
    this.panelButton.setAttribute("aria-pressed", !this.panel.hidden);
  }

  escape() {
    if (this.lens.isOn) this.toggleInspector();
    else if (this.comparison.mode !== "off") this.setCompare({ mode: "off" });
  }

  showHelp() {
    this.help.showModal();
    // The focus is on the button below the list.
    this.help.scrollTop = 0;
  }

  // Requests.

  ask(kind, fields = {}) {
    const id = this.nextId++;
    this.transport.send({ kind, id, ...fields });
    return id;
  }

  // One request per frame, whatever changes meanwhile.
  schedule() {
    this.updateStatus();
    if (this.isScheduled) return;
    this.isScheduled = true;
    requestAnimationFrame(() => {
      this.isScheduled = false;
      this.paint();
      this.askPictures();
    });
  }

  request(slot = "a") {
    const fields = { slot, subject: this.current, view: copyOf(this.view), settings: this.settings };
    if (slot === "a") return fields;
    const { against } = this.comparison;
    const file = /^file (\d+)$/.exec(against);
    if (file) fields.subject = +file[1];
    else if (against === "pinned") fields.settings = this.pinned;
    else fields.settings = { ...this.settings, ...COMPARISONS[against] };
    return fields;
  }

  askPictures() {
    if (!this.isReady()) return;
    let hasAsked = false;
    for (const slot of this.slots()) {
      const request = this.request(slot);
      const key = JSON.stringify([request, this.subjects[request.subject]?.version]);
      if (this.wanted[slot]?.key === key) continue;
      this.wanted[slot] = { id: this.ask("picture", request), key };
      this.askedAt = performance.now();
      hasAsked = true;
    }
    if (hasAsked) this.setState("pending");
    else if (this.isExact()) this.onExact();
    clearTimeout(this.busyTimer);
    this.busyTimer = setTimeout(() => this.updateStatus(), BUSY_MS + 10);
  }

  slots() {
    return this.comparison.mode === "off" ? ["a"] : ["a", "b"];
  }

  isExact() {
    return this.slots().every((slot) => {
      const picture = this.pictures[slot];
      return picture && picture.id === this.wanted[slot]?.id && sameView(picture.view, this.view);
    });
  }

  setState(state) {
    this.root.dataset.state = state;
    this.updateStatus();
  }

  // Overlays and the inspector are requested once the exact picture is shown.
  onExact() {
    this.setState("exact");
    for (const kind of ["edges", "tiles", "gradients"]) {
      if (!this.overlays[kind] || this.subject().is_image) continue;
      const fields = { ...this.request(), slot: kind };
      if (kind === "gradients") fields.target = this.target();
      const key = JSON.stringify([fields, this.subject().version]);
      if (this.overlayData[kind]?.key === key) continue;
      const view = copyOf(this.view);
      this.overlayData[kind] = { ...this.overlayData[kind], key, requested: { id: this.ask(kind, fields), view } };
    }
    if (this.lens.isOn) this.askReport();
  }

  receive(header, payload) {
    if (header.kind === "error") return this.onError(header);
    const handlers = {
      subjects: () => this.onSubjects(header),
      changed: () => this.ask("subjects"),
      picture: () => this.onPicture(header, payload),
      png: () => this.onPng(header, payload),
      inspect: () => this.onReport(header, payload),
      reference: () => this.onReference(header),
      edges: () => this.onOverlay(header, payload, Float32Array),
      tiles: () => this.onOverlay(header, payload, Uint32Array),
      gradients: () => this.onOverlay(header, payload, Float32Array),
      costs: () => this.onCost(header),
    };
    handlers[header.kind]?.();
  }

  onSubjects({ subjects }) {
    const isFirst = !this.subjects.length;
    const before = this.subject();
    // A file that cannot be read, such as one that is half written, keeps its last size.
    subjects.forEach((subject, number) => {
      const { height, width } = this.subjects[number] ?? subject;
      if (subject.error) Object.assign(subject, { height, width });
    });
    this.subjects = subjects;
    if (before && before.version !== this.subject().version) this.cancelCosts();
    this.files.hidden = subjects.length < 2;
    this.subjectChoice.replaceChildren(
      ...subjects.map(({ name }, at) => h("option", { value: at }, `${at + 1}  ${name}`)),
    );
    document.title = this.isWidget ? document.title : `${this.subject().name} – softras2d`;
    this.fillAgainst();
    if (isFirst) {
      // The triangles of a fit that runs are shown over its picture.
      this.overlays.edges = Boolean(this.subject().fit?.is_running);
      this.fit();
    } else if (before.height !== this.subject().height || before.width !== this.subject().width) {
      this.fit();
    }
    this.updateControls();
    this.updateFit();
    this.schedule();
  }

  onPicture(header, payload) {
    const { slot } = header;
    const shown = this.pictures[slot];
    if (shown && shown.id > header.id) return;
    const wanted = this.wanted[slot];
    const { height, width } = header;
    const rgba = unpackPixels(header, payload);
    let canvas = shown?.canvas;
    if (!canvas || canvas.width !== width || canvas.height !== height) {
      canvas = new OffscreenCanvas(width, height);
    }
    canvas.getContext("2d").putImageData(new ImageData(rgba, width, height), 0, 0);
    this.pictures[slot] = { canvas, rgba, view: header.view, header, id: header.id };
    this.error = header.id === wanted?.id ? "" : this.error;
    this.still.hidden = true;
    if (slot === "a") this.updatePlan(header);
    this.paint();
    if (this.isExact()) {
      this.root.dataset.drawnMs = (performance.now() - this.askedAt).toFixed(1);
      this.onExact();
    }
  }

  onError({ request, message, slot, id }) {
    if (request === "picture") {
      if (id !== this.wanted[slot]?.id) return;
      this.error = message;
      this.setState("error");
    } else if (request === "inspect") {
      if (id !== this.lens.requested?.id) return;
      const { key } = this.lens;
      this.hideReport();
      // The same request would fail again.
      this.lens.key = key;
    } else if (request === "gradients" || request === "tiles" || request === "edges") {
      this.overlays[request] = false;
      this.updateControls();
    } else if (request === "costs") {
      if (id !== this.costId) return;
      this.cancelCosts();
      this.updateEffects();
    }
    this.say(message);
  }

  onClosed() {
    this.isClosed = true;
    this.setState("closed");
  }

  onOverlay(header, payload, kind) {
    const data = this.overlayData[header.kind];
    if (data?.requested?.id !== header.id) return;
    const bytes = payload.buffer.slice(payload.byteOffset, payload.byteOffset + payload.byteLength);
    this.overlayData[header.kind] = { ...data, view: data.requested.view, header, values: new kind(bytes) };
    this.paint();
    this.updateStatus();
  }

  // Saving and copying.

  save() {
    if (!this.isReady()) return;
    if (this.comparison.mode === "off") return this.ask("png", this.request());
    // A comparison is saved as it is shown.
    this.picture.toBlob((blob) => this.download(blob, this.subject().name, "comparison"));
  }

  download(blob, name, suffix) {
    const url = URL.createObjectURL(blob);
    h("a", { href: url, download: `${name.replace(/\.[^.]*$/, "")}-${suffix}.png` }).click();
    setTimeout(() => URL.revokeObjectURL(url), 1e4);
  }

  onPng({ name }, payload) {
    this.download(new Blob([payload], { type: "image/png" }), name, "view");
  }

  async copyCommand() {
    const command = this.pictures.a?.header.command;
    if (!command) return this.say("There is no command for this.");
    try {
      await navigator.clipboard.writeText(command);
      this.say(`Copied: ${command}`);
    } catch {
      this.say(command);
    }
  }

  say(message) {
    this.toast.textContent = message;
    this.toast.hidden = false;
    clearTimeout(this.toastTimer);
    this.toastTimer = setTimeout(() => (this.toast.hidden = true), 6000);
  }

  // Painting.

  paint() {
    if (!this.view) return;
    const { context, comparison } = this;
    const { a, b } = this.pictures;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, this.picture.width, this.picture.height);
    const { width, height } = this.view;
    if (comparison.mode === "difference" && a && b && sameView(a.view, b.view)) {
      this.paintDifference(a, b);
    } else {
      const edge = comparison.mode === "slider" ? Math.round(comparison.split * width) : width;
      this.paintPicture(a, 0, edge);
      if (comparison.mode === "slider") {
        this.paintPicture(b ?? a, edge, width);
      }
    }
    this.paintOverlay(width, height);
  }

  // The part of a picture from column `left` to `right` of the canvas, moved to the view.
  paintPicture(picture, left, right) {
    if (!picture || right <= left) return;
    const { context, view } = this;
    context.save();
    context.beginPath();
    context.rect(left, 0, right - left, view.height);
    context.clip();
    if (sameView(picture.view, view)) {
      context.drawImage(picture.canvas, 0, 0);
    } else {
      const scale = view.zoom / picture.view.zoom;
      context.imageSmoothingEnabled = scale < 1;
      context.setTransform(scale, 0, 0, scale, picture.view.x * scale - view.x, picture.view.y * scale - view.y);
      context.drawImage(picture.canvas, 0, 0);
    }
    context.restore();
  }

  paintDifference(a, b) {
    const key = `${a.id} ${b.id}`;
    if (this.difference?.key !== key) {
      const { width, height } = a.canvas;
      const image = new ImageData(width, height);
      let [most, differing] = [0, 0];
      for (let at = 0; at < image.data.length; at += 4) {
        let largest = 0;
        for (let channel = 0; channel < 3; channel++) {
          const d = Math.abs(a.rgba[at + channel] - b.rgba[at + channel]);
          image.data[at + channel] = DIFFERENCE_GAIN * d;
          if (d > largest) largest = d;
        }
        image.data[at + 3] = 255;
        largest = Math.max(largest, Math.abs(a.rgba[at + 3] - b.rgba[at + 3]));
        if (largest) differing++;
        if (largest > most) most = largest;
      }
      const canvas = new OffscreenCanvas(width, height);
      canvas.getContext("2d").putImageData(image, 0, 0);
      this.difference = { key, canvas, most, differing, pixels: width * height };
    }
    const { most, differing, pixels } = this.difference;
    this.differenceNote.textContent =
      `${differing.toLocaleString("en")} of ${pixels.toLocaleString("en")} pixels differ, by ${most} of 255 ` +
      `at most. Shown × ${DIFFERENCE_GAIN}.`;
    this.paintPicture({ canvas: this.difference.canvas, view: a.view }, 0, this.view.width);
  }

  paintOverlay(width, height) {
    const context = this.overlay.getContext("2d", { willReadFrequently: false });
    const size = this.pixelSize;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, this.overlay.width, this.overlay.height);
    this.paintFrame(context, size);
    if (size >= 8) this.paintGrid(context, width, height, size);
    for (const [kind, paint] of [["tiles", "paintTiles"], ["edges", "paintEdges"], ["gradients", "paintGradients"]]) {
      const data = this.overlayData[kind];
      if (!this.overlays[kind] || !data?.values) continue;
      const scale = this.view.zoom / data.view.zoom;
      const offset = [data.view.x * scale - this.view.x, data.view.y * scale - this.view.y];
      context.setTransform(scale * size, 0, 0, scale * size, offset[0] * size, offset[1] * size);
      // Line styles of one overlay must not reach the next frame.
      context.save();
      this[paint](context, data, scale * size);
      context.restore();
    }
    context.setTransform(1, 0, 0, 1, 0, 0);
    if (this.comparison.mode === "slider") {
      const edge = Math.round(this.comparison.split * width) * size;
      context.fillStyle = "rgb(0 0 0 / 55%)";
      context.fillRect(edge - 1, 0, 2, this.overlay.height);
      context.fillStyle = "rgb(255 255 255 / 75%)";
      context.fillRect(edge, 0, 1, this.overlay.height);
    }
    if (this.lens.isOn && this.lens.isPlaced) {
      const { column, row } = this.lens;
      const box = [column * size - 1.5, row * size - 1.5, size + 3, size + 3];
      context.lineWidth = 3;
      context.strokeStyle = "rgb(0 0 0 / 70%)";
      context.strokeRect(...box);
      context.lineWidth = 1;
      context.strokeStyle = "#fff";
      context.strokeRect(...box);
    }
  }

  // The outline of the drawing's canvas; what lies outside of it is dimmed.
  paintFrame(context, size) {
    if (!this.subjects.length) return;
    const { view } = this;
    const { width, height } = this.subject();
    const frame = [
      -view.x * size, -view.y * size,
      Math.round(width * view.zoom) * size, Math.round(height * view.zoom) * size,
    ];
    context.beginPath();
    context.rect(0, 0, this.overlay.width, this.overlay.height);
    context.rect(...frame);
    context.fillStyle = "rgb(128 128 128 / 30%)";
    context.fill("evenodd");
    context.strokeStyle = "rgb(128 128 128 / 60%)";
    context.lineWidth = 1;
    context.strokeRect(frame[0] - 0.5, frame[1] - 0.5, frame[2] + 1, frame[3] + 1);
  }

  paintGrid(context, width, height, size) {
    context.beginPath();
    for (let x = 1; x < width; x++) context.rect(x * size, 0, 0, height * size);
    for (let y = 1; y < height; y++) context.rect(0, y * size, width * size, 0);
    context.strokeStyle = "rgb(128 128 128 / 35%)";
    context.lineWidth = 1;
    context.stroke();
  }

  paintEdges(context, { values }, scale) {
    context.beginPath();
    for (let at = 0; at < values.length; at += 6) {
      context.moveTo(values[at], values[at + 1]);
      context.lineTo(values[at + 2], values[at + 3]);
      context.lineTo(values[at + 4], values[at + 5]);
      context.closePath();
    }
    context.lineJoin = "bevel";
    context.lineWidth = 2.2 / scale;
    context.strokeStyle = "rgb(255 255 255 / 28%)";
    context.stroke();
    context.lineWidth = 0.9 / scale;
    context.strokeStyle = "rgb(20 24 30 / 80%)";
    context.stroke();
  }

  paintTiles(context, { header, values }, scale) {
    const { rows, columns, tile_width: w, tile_height: h, most } = header;
    const hasNumbers = Math.min(w, h) * scale >= 22;
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.font = `${11 / scale}px system-ui, sans-serif`;
    for (let row = 0; row < rows; row++) {
      for (let column = 0; column < columns; column++) {
        const count = values[row * columns + column];
        if (!count) continue;
        const share = Math.sqrt(count / Math.max(most, 1));
        context.fillStyle = `rgb(${[190 + 60 * share, 120 - 70 * share, 20 + 60 * (1 - share)].map(Math.round).join(" ")} / ${0.12 + 0.55 * share})`;
        context.fillRect(column * w, row * h, w, h);
        if (hasNumbers) {
          context.fillStyle = "#000";
          context.fillText(count, (column + 0.5) * w, (row + 0.5) * h);
        }
      }
    }
    context.beginPath();
    for (let column = 0; column <= columns; column++) {
      context.moveTo(column * w, 0);
      context.lineTo(column * w, rows * h);
    }
    for (let row = 0; row <= rows; row++) {
      context.moveTo(0, row * h);
      context.lineTo(columns * w, row * h);
    }
    context.lineWidth = 1 / scale;
    context.strokeStyle = "rgb(90 60 30 / 30%)";
    context.stroke();
  }

  // Arrows against the gradient: the way in which the difference shrinks.
  paintGradients(context, { values }, scale) {
    let longest = 0;
    for (let at = 0; at < values.length; at += 4) {
      longest = Math.max(longest, Math.hypot(values[at + 2], values[at + 3]));
    }
    if (!longest) return;
    const length = ARROW_PIXELS / scale / longest;
    const head = 6 / scale;
    for (const [width, color] of [[3.5, "rgb(255 255 255 / 80%)"], [1.6, "#b3261e"]]) {
      context.beginPath();
      for (let at = 0; at < values.length; at += 4) {
        const [x, y] = [values[at], values[at + 1]];
        const [dx, dy] = [-values[at + 2] * length, -values[at + 3] * length];
        const norm = Math.hypot(dx, dy);
        if (norm < 1.5 / scale) continue;
        const [ux, uy] = [dx / norm, dy / norm];
        const tip = [x + dx, y + dy];
        const back = Math.min(head, norm / 2);
        context.moveTo(x, y);
        context.lineTo(...tip);
        context.moveTo(tip[0] - back * (ux + 0.5 * uy), tip[1] - back * (uy - 0.5 * ux));
        context.lineTo(...tip);
        context.lineTo(tip[0] - back * (ux - 0.5 * uy), tip[1] - back * (uy + 0.5 * ux));
      }
      context.lineWidth = width / scale;
      context.strokeStyle = color;
      context.stroke();
    }
  }

  // The pixel inspector.

  toggleInspector() {
    const { lens } = this;
    if (!lens.isOn && this.subject().is_image) return this.say("An image has no samples to inspect.");
    lens.isOn = !lens.isOn;
    this.stage.classList.toggle("sr-inspecting", lens.isOn);
    if (lens.isOn) {
      lens.isLocked = false;
      this.lookAt(Math.floor(this.view.width / 2), Math.floor(this.view.height / 2));
    } else this.hideReport();
    this.updateControls();
    this.paint();
  }

  lookAt(column, row) {
    const { lens, view } = this;
    lens.column = clamp(column, 0, view.width - 1);
    lens.row = clamp(row, 0, view.height - 1);
    lens.isPlaced = true;
    this.paint();
    this.placeLens();
    this.askReport();
  }

  // One request at a time: the next one is for where the pointer is then.
  askReport() {
    const { lens } = this;
    if (!lens.isOn || this.subject().is_image) return;
    const fields = { ...this.request(), slot: "lens", column: lens.column, row: lens.row };
    const key = JSON.stringify([fields, this.subject().version]);
    if (lens.key === key || lens.isAsking || this.root.dataset.state !== "exact") return;
    lens.key = key;
    lens.isAsking = true;
    lens.requested = { id: this.ask("inspect", fields), view: fields.view };
  }

  onReport(header, payload) {
    const { lens } = this;
    if (header.id !== lens.requested?.id) return;
    lens.isAsking = false;
    if (!lens.isOn) return;
    lens.report = { ...header, view: lens.requested.view, bytes: new Uint8ClampedArray(payload.buffer, payload.byteOffset, payload.byteLength) };
    lens.reference = null;
    this.paintLens();
    this.askReport();
  }

  onReference(header) {
    const { lens } = this;
    if (header.id !== lens.report?.id) return;
    lens.reference = header;
    this.paintLensValues();
  }

  hideReport() {
    Object.assign(this.lens, { report: null, reference: null, key: null, isAsking: false, requested: null });
    this.lensCard.hidden = true;
  }

  // Puts the lens beside the pixel, where it fits.
  placeLens() {
    const { lens, lensCard } = this;
    lensCard.classList.toggle("sr-locked", lens.isLocked);
    if (!lens.report) return;
    const box = this.stage.getBoundingClientRect();
    const scale = this.screenScale();
    const at = [this.margin[0] + (lens.column + 0.5) / scale, this.margin[1] + (lens.row + 0.5) / scale];
    const size = [lensCard.offsetWidth, lensCard.offsetHeight];
    const side = (axis, length) => {
      const after = at[axis] + 26;
      return after + size[axis] < length - 6 ? after : Math.max(6, at[axis] - 26 - size[axis]);
    };
    const left = side(0, box.width);
    const isBeside = left > at[0] || left + size[0] < at[0];
    const top = isBeside ? clamp(at[1] - size[1] / 2, 6, Math.max(6, box.height - size[1] - 6)) : side(1, box.height);
    lensCard.style.left = `${left}px`;
    lensCard.style.top = `${top}px`;
  }

  paintLens() {
    const { report } = this.lens;
    this.lensCard.hidden = false;
    this.paintLensPixels(report);
    this.paintLensSamples(report);
    const noun = report.rate > 1 ? `${report.rate ** 2} samples` : "1 sample";
    this.lensTitle.textContent = `Pixel ${report.column + report.view.x}, ${report.row + report.view.y}`;
    this.lensTitle.title = noun;
    this.paintLensValues();
    this.paintLayers(report);
    this.placeLens();
  }

  // The pixels around the inspected one, with the colour of each of their samples.
  paintLensPixels(report) {
    const context = this.lensCanvas.getContext("2d");
    const side = this.lensCanvas.width / report.lens;
    const picture = sameView(this.pictures.a?.view, report.view) ? this.pictures.a : null;
    const half = (report.lens - 1) / 2;
    const sampleSide = side / report.rate;
    context.clearRect(0, 0, this.lensCanvas.width, this.lensCanvas.height);
    for (let row = 0; row < report.lens; row++) {
      for (let column = 0; column < report.lens; column++) {
        const [x, y] = [report.column - half + column, report.row - half + row];
        if (picture && x >= 0 && y >= 0 && x < picture.canvas.width && y < picture.canvas.height) {
          const at = 4 * (y * picture.canvas.width + x);
          const [r, g, b, a] = picture.rgba.subarray(at, at + 4);
          context.fillStyle = `rgb(${r} ${g} ${b} / ${a / 255})`;
          context.fillRect(column * side, row * side, side, side);
        }
      }
    }
    if (report.rate <= 4) {
      const columns = report.lens * report.rate;
      for (let at = 0; at < columns * columns; at++) {
        const [r, g, b, a] = report.bytes.subarray(4 * at, 4 * at + 4);
        context.beginPath();
        context.arc(((at % columns) + 0.5) * sampleSide, (Math.floor(at / columns) + 0.5) * sampleSide,
          Math.min(0.3 * sampleSide, 6), 0, 2 * Math.PI);
        context.fillStyle = `rgb(${r} ${g} ${b} / ${a / 255})`;
        context.fill();
        context.lineWidth = 0.75;
        context.strokeStyle = "rgb(128 128 128 / 60%)";
        context.stroke();
      }
    }
    context.beginPath();
    for (let line = 0; line <= report.lens; line++) {
      context.moveTo(line * side, 0);
      context.lineTo(line * side, this.lensCanvas.height);
      context.moveTo(0, line * side);
      context.lineTo(this.lensCanvas.width, line * side);
    }
    context.lineWidth = 1;
    context.strokeStyle = "rgb(128 128 128 / 50%)";
    context.stroke();
    this.paintCorners(context, report, side, 0, 0);
    for (const [width, color] of [[5, "rgb(0 0 0 / 65%)"], [2, "#fff"]]) {
      context.lineWidth = width;
      context.strokeStyle = color;
      context.strokeRect(half * side, half * side, side, side);
    }
  }

  // The inspected pixel alone: its samples over the edges of the triangles that cover it.
  paintLensSamples(report) {
    const context = this.pixelCanvas.getContext("2d");
    const margin = 8;
    const side = this.pixelCanvas.width - 2 * margin;
    const half = (report.lens - 1) / 2;
    context.clearRect(0, 0, this.pixelCanvas.width, this.pixelCanvas.height);
    context.fillStyle = css(report.value);
    context.fillRect(margin, margin, side, side);
    context.strokeStyle = "rgb(128 128 128 / 80%)";
    context.lineWidth = 1;
    context.strokeRect(margin, margin, side, side);
    context.save();
    context.translate(margin, margin);
    this.paintCorners(context, report, side, half, half);
    const step = side / report.rate;
    report.samples.forEach(({ triangle, color }, at) => {
      context.beginPath();
      context.arc(((at % report.rate) + 0.5) * step, (Math.floor(at / report.rate) + 0.5) * step,
        Math.min(0.32 * step, 22), 0, 2 * Math.PI);
      context.fillStyle = css(color);
      context.fill();
      context.lineWidth = triangle < 0 ? 1 : 2;
      context.setLineDash(triangle < 0 ? [3, 3] : []);
      context.strokeStyle = "rgb(30 30 30 / 75%)";
      context.stroke();
    });
    context.restore();
  }

  paintCorners(context, report, side, left, top) {
    context.save();
    context.beginPath();
    context.rect(0, 0, (report.lens - 2 * left) * side, (report.lens - 2 * top) * side);
    context.clip();
    context.beginPath();
    for (const { corners } of report.edges) {
      corners.forEach(([x, y], at) => {
        const point = [clamp((x - left) * side, -1e5, 1e5), clamp((y - top) * side, -1e5, 1e5)];
        context[at ? "lineTo" : "moveTo"](...point);
      });
      context.closePath();
    }
    context.lineWidth = 3.5;
    context.strokeStyle = "rgb(255 255 255 / 55%)";
    context.stroke();
    context.lineWidth = 1.5;
    context.strokeStyle = "rgb(20 24 30 / 85%)";
    context.stroke();
    context.restore();
  }

  paintLensValues() {
    const { report, reference } = this.lens;
    const row = (name, value) => [
      h("span", { class: "sr-swatch", style: { background: css(value) } }),
      h("span", {}, name),
      h("span", {}, value.map((v) => v.toFixed(4)).join("  ")),
    ];
    const rows = row("drawn", report.value);
    rows.push(...(reference ? row(reference.name, reference.value) : [h("span"), h("span", {}, "exact …"), h("span")]));
    this.lensValues.replaceChildren(...rows);
  }

  paintLayers({ layers, rate, samples, most_layers: most }) {
    if (!layers.length) {
      return this.lensTable.replaceChildren(h("p", { class: "sr-hint" }, "No triangle covers this pixel."));
    }
    const has = (name) => layers.some((layer) => layer[name] != null);
    const columns = [
      ["triangle", ({ triangle, color }) => [h("span", { class: "sr-swatch", style: { background: css(color) } }), ` ${triangle}`]],
      ["covers", (layer) => (samples.length ? `${new Set(layer.samples).size} / ${rate ** 2}` : layer.coverage.toFixed(3))],
      ["weights", ({ weights }) => weights.map((w) => w.toFixed(2)).join(" ")],
      ...(has("depth") ? [["depth", ({ depth }) => depth.toFixed(4)]] : []),
      ...(has("uv") ? [["u, v", ({ uv }) => uv.map((t) => t.toFixed(3)).join(" ")]] : []),
      ...(has("level") ? [["level", ({ level }) => level.toFixed(2)]] : []),
    ];
    const table = h(
      "table", {},
      h("thead", {}, h("tr", {}, ...columns.map(([name]) => h("th", { scope: "col" }, name)))),
      h("tbody", {}, ...layers.slice(0, 10).map((layer) =>
        h("tr", {}, ...columns.map(([, cell]) => h("td", {}, ...[cell(layer)].flat()))))),
    );
    const hints = [];
    if (layers.length > 10 || layers.length >= most) hints.push("Nearest first; there may be more behind.");
    if (!samples.length && this.effectNames?.includes("texture")) hints.push("Colours without texture.");
    this.lensTable.replaceChildren(table, ...hints.map((text) => h("p", { class: "sr-hint" }, text)));
  }

  // What the panel and the status line say.

  updateControls() {
    const { controls, settings, comparison } = this;
    const check = (name, value) => {
      for (const input of controls[name].querySelectorAll("input")) input.checked = input.value === `${value}`;
    };
    for (const name of ["coverage", "samples", "fill_rule", "shading", "pixel_filter", "level_filter", "anisotropy"]) {
      check(name, settings[name]);
    }
    check("mode", comparison.mode);
    controls.soft_width.show(settings.soft_width);
    controls.lod_bias.show(settings.lod_bias);
    this.panel.classList.toggle("sr-of-image", Boolean(this.subject()?.is_image));
    const isSampled = settings.coverage === "sampled";
    this.coverageNote.hidden = isSampled;
    this.coverageNote.textContent = COVERAGE_NOTES[settings.coverage];
    for (const name of ["samples", "fill_rule", "shading"]) controls[name].hidden = !isSampled;
    controls.soft_width.hidden = settings.coverage !== "soft";
    for (const [name, isOn] of Object.entries(this.overlays)) controls[name].querySelector("input").checked = isOn;
    for (const part of [this.slider, ...this.sideNames]) part.hidden = comparison.mode !== "slider";
    this.differenceNote.hidden = comparison.mode !== "difference";
    this.sideNames[0].textContent = this.describe(settings);
    this.fillAgainst();
    this.sideNames[1].textContent = this.againstChoice.selectedOptions[0]?.textContent ?? "";
    this.subjectChoice.value = this.current;
    this.pixelChoice.value = this.pixelSize;
    this.inspectButton.setAttribute("aria-pressed", this.lens.isOn);
    this.compareButton.setAttribute("aria-pressed", comparison.mode !== "off");
    this.panelButton.setAttribute("aria-pressed", !this.panel.hidden);
    this.overlayNote.hidden = !(this.overlays.tiles && this.overlayData.tiles?.header);
    this.updateEffects();
  }

  fillAgainst() {
    const options = Object.keys(COMPARISONS).map((name) => [name, name]);
    if (this.pinned) options.push(["pinned", "pinned settings"]);
    this.subjects.forEach(({ name }, at) => {
      if (at !== this.current) options.push([`file ${at}`, name]);
    });
    if (!options.some(([value]) => value === this.comparison.against)) this.comparison.against = "1 sample";
    this.againstChoice.replaceChildren(...options.map(([value, text]) => h("option", { value }, text)));
    this.againstChoice.value = this.comparison.against;
  }

  describe(settings) {
    if (settings.coverage === "soft") return `soft edges, ${+settings.soft_width.toPrecision(2)} px`;
    if (settings.coverage === "area") return "area coverage";
    return settings.samples === 1 ? "1 sample" : `${settings.samples} samples`;
  }

  updatePlan(header) {
    this.plan.textContent = header.plan;
    const effects = header.effects ?? [];
    if (`${effects}` !== `${this.effectNames}`) {
      this.effectNames = effects;
      this.updateEffects();
    }
    const hasTexture = effects.includes("texture");
    this.textureSection.hidden = !hasTexture;
  }

  updateEffects() {
    const effects = this.effectNames ?? [];
    const row = (name) => {
      const cost = this.costs.get(name);
      const text = cost ? `${cost >= 0 ? "+" : "−"}${Math.abs(cost).toFixed(1)} ms` : "";
      return h("li", {}, h("span", {}, name), h("span", {}, text));
    };
    this.effects.replaceChildren(...(effects.length ? effects.map(row) : [h("li", {}, "none")]));
    this.measureButton.disabled = Boolean(this.isMeasuring);
    this.measureButton.textContent = this.isMeasuring ? "Measuring …" : "Measure what each costs";
    this.measureButton.hidden = !effects.length;
  }

  // Forgets the costs of other settings or another file, also those that are being measured.
  cancelCosts() {
    this.costs.clear();
    this.costId = null;
    this.isMeasuring = false;
  }

  measure() {
    if (!this.isReady()) return;
    this.costs.clear();
    this.isMeasuring = true;
    this.costId = this.ask("costs", { ...this.request(), slot: "costs" });
    this.updateEffects();
  }

  onCost(header) {
    if (header.id !== this.costId) return;
    if (header.effect) this.costs.set(header.effect, header.milliseconds - header.milliseconds_without);
    if (header.is_last) this.isMeasuring = false;
    this.updateEffects();
  }

  updateFit() {
    const fit = this.subject()?.fit;
    this.fitCard.hidden = !fit || fit.history.length < 2;
    if (this.fitCard.hidden) return;
    const { history } = fit;
    const seconds = history.map((row) => row[1]);
    const psnr = history.map((row) => row[2]);
    const [low, high] = [Math.min(...psnr), Math.max(...psnr)];
    const [first, last] = [seconds[0], Math.max(seconds.at(-1), seconds[0] + 1e-3)];
    const points = history.map(([, time, value]) =>
      `${(100 * (time - first)) / (last - first)},${60 - (56 * (value - low)) / Math.max(high - low, 1e-6)}`);
    const space = "http://www.w3.org/2000/svg";
    const svg = document.createElementNS(space, "svg");
    svg.setAttribute("viewBox", "0 0 100 62");
    svg.setAttribute("preserveAspectRatio", "none");
    svg.setAttribute("role", "img");
    svg.setAttribute("aria-label", `PSNR from ${psnr[0].toFixed(1)} to ${psnr.at(-1).toFixed(1)} dB`);
    const line = document.createElementNS(space, "polyline");
    line.setAttribute("points", points.join(" "));
    svg.append(line);
    const [steps, time, value, active] = history.at(-1);
    const state = fit.is_running ? "fitting" : "fitted";
    this.fitCard.replaceChildren(
      h("div", { class: "sr-label" }, `${state}, ${active} triangles`, h("strong", {}, `${value.toFixed(2)} dB`)),
      svg,
      h("div", { class: "sr-label" }, `step ${steps}`, h("span", {}, `${time.toFixed(1)} s`)),
    );
    this.root.dataset.fitSteps = steps;
  }

  updateStatus() {
    const { statusParts: parts, view, settings } = this;
    const subject = this.subject();
    const header = this.pictures.a?.header;
    parts.coverage.textContent = subject?.is_image ? "image" : this.describe(settings);
    parts.size.textContent = view ? `${view.width} × ${view.height} px` : "";
    parts.zoom.textContent = view ? percent(view.zoom) : "";
    parts.position.textContent = view ? `at ${view.x}, ${view.y}` : "";
    const state = this.root.dataset.state;
    const message = subject?.error || this.error || header?.notes?.[0] || "";
    parts.notes.textContent = this.isClosed ? "The viewer has ended." : message;
    parts.notes.className = this.isClosed || this.error || subject?.error ? "sr-wrong" : "sr-optional";
    const isLong = state === "pending" && performance.now() - this.askedAt > BUSY_MS;
    parts.time.className = isLong ? "sr-busy" : "";
    if (isLong) parts.time.textContent = header ? "drawing" : "compiling";
    else if (header && state === "exact") {
      const compiled = header.compile_seconds > 0 ? `, of which ${header.compile_seconds.toFixed(1)} s compiling` : "";
      const time = header.milliseconds >= 1000 ? `${(header.milliseconds / 1000).toFixed(1)} s` : `${header.milliseconds.toFixed(0)} ms`;
      parts.time.textContent = subject?.is_image ? "" : `${time}${compiled}`;
    }
    const tiles = this.overlayData.tiles?.header;
    if (tiles) {
      this.overlayNote.textContent =
        `${tiles.columns} × ${tiles.rows} tiles of ${tiles.tile_width} × ${tiles.tile_height} px; ` +
        `${tiles.mean.toFixed(1)} triangles each, ${tiles.max} at most. ` +
        `${tiles.pairs_listed.toLocaleString("en")} pairs; the plan holds ${tiles.pairs_capacity.toLocaleString("en")}.`;
      this.overlayNote.hidden = !this.overlays.tiles;
    }
  }

  close() {
    (this.isWidget ? this.root : document).removeEventListener("keydown", this.onKey);
    this.resizing.disconnect();
    this.transport.close();
  }
}

export function mount(root, transport, options) {
  return new Viewer(root, transport, options);
}

// Hides the picture that a notebook shows above the widget for pages without a kernel.
function hideStill(el, still) {
  const outputs = el.closest(".jp-OutputArea, .output, .cell-output") ?? el.parentElement;
  for (const image of outputs?.querySelectorAll("img") ?? []) {
    // Line breaks in the data of an output are not part of its picture.
    if (image.closest(".sr-viewer") || image.src.replace(/\s|%0A/g, "") !== still) continue;
    (image.closest(".jp-OutputArea-child, .output_area") ?? image).style.display = "none";
  }
}

// The notebook widget, as anywidget calls it.
export default {
  render({ model, el }) {
    const root = document.createElement("div");
    root.style.height = `${model.get("height")}px`;
    el.append(root);
    const still = model.get("still");
    const viewer = mount(root, openModel(model), { isWidget: true, still });
    // The element may not be part of the page yet.
    requestAnimationFrame(() => hideStill(el, still));
    return () => viewer.close();
  },
};

// The page of `softras2d view`.
const page = document.querySelector("[data-softras2d-page]");
if (page) {
  const address = new URL("socket", location.href);
  address.protocol = "ws:";
  mount(page, openSocket(address));
}
