// The front end of the viewer, both for the page of `softras2d view` and for the notebook widget.
//
// It shows subjects, which are drawings or images. It keeps a view, settings and overlays, and
// requests exact pictures of them from Python, which draws them. Until an exact picture arrives,
// it shows the last one, moved and scaled to the current view. It loads nothing from the internet.
//
// There are four kinds of pixels:
// - Pixels of the drawing are its units at zoom 1.
// - Canvas pixels are the pixels that Python draws. `view.zoom` canvas pixels are one pixel of the
//   drawing, and `view.x, view.y` is the pixel of the enlarged drawing at the upper left of the
//   canvas (`view.py`).
// - Screen pixels are those of the display; a canvas pixel is `pixelSize` of them wide.
// - CSS pixels are those of pointer events and of the layout; `devicePixelRatio` screen pixels are
//   one CSS pixel.

// Names and bounds that Python has too: `tests/viewing/test_page_constants.py` compares them.
const COVERAGES = ["sampled", "soft", "area"];
const SAMPLES = [1, 4, 9, 16, 64];
const FILL_RULES = ["inclusive", "top_left"];
const SHADINGS = ["sample", "pixel"];
const SOFT_WIDTHS = [0.1, 8]; // Least and greatest width of soft edges, in canvas pixels.
const PIXEL_FILTERS = ["nearest", "bilinear"];
const LEVEL_FILTERS = ["zero", "nearest", "linear"];
const ANISOTROPIES = [1, 2, 4, 8, 16];
const LOD_BIASES = [-4, 4]; // Least and greatest bias.

const PIXEL_SIZES = [1, 2, 4, 8, 16, 32];
const ZOOM_STEP = 1.25;
// Bounds on the longer side of the enlarged drawing, in canvas pixels. Beyond the upper one,
// coordinates in float32 are too coarse.
const MIN_DRAWING_SIDE = 4;
const MAX_DRAWING_SIDE = 65536;
const MAX_OFFSET = 2 ** 20; // Bound on `view.x` and `view.y`.
const MAX_CANVAS_SIDE = 8192;
const MAX_CANVAS_PIXELS = 2 ** 24;
const CANVAS_STEP = 32; // Canvas sides are multiples of this many screen pixels.
const NARROW_WIDTH = 900; // Up to this width, in CSS pixels, a viewer starts without its panel.

const BLOCK = 16; // Pixels per block of a packed picture, as in `packed_pixels.py`.
const BUSY_MS = 150; // After this time, the status line says that a picture is being drawn.
const DIFFERENCE_GAIN = 4;
const MAX_ARROW_LENGTH = 48; // Length of the longest gradient, in screen pixels.
const MAX_LISTED_LAYERS = 10; // Rows of the table of the pixel inspector.

// The settings that a view starts with, as in `settings.py`.
const DEFAULT_SETTINGS = {
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

// Changes of the settings that a picture can be compared with. The pinned settings and the other
// files can be chosen too.
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
  soft: "Triangles fade across their edges, so that the background shows at the seams of " +
    "adjacent ones.",
  area: "Each triangle covers its exact area of a pixel and is blended over those behind, so " +
    "that the background shows at the seams of adjacent triangles. The inspector shows the " +
    "exact value.",
};

// Each key, what it does, and the action. Rows without an action only describe keys that
// `onKeyDown` handles. The keys up to the space bar are those of the rasterizer course's viewer.
const KEYS = [
  ["-", "fewer samples", (viewer) => viewer.stepSetting("samples", SAMPLES, -1)],
  ["=", "more samples", (viewer) => viewer.stepSetting("samples", SAMPLES, 1)],
  ["z", "pixel inspector", (viewer) => viewer.toggleInspector()],
  ["p", "pixel filter of textures", (viewer) => viewer.cycle("pixel_filter", PIXEL_FILTERS)],
  ["l", "level filter of textures", (viewer) => viewer.cycle("level_filter", LEVEL_FILTERS)],
  [" ", "fit the drawing", (viewer) => viewer.fitToStage()],
  ["s", "save as PNG", (viewer) => viewer.save()],
  ["1-9", "show this file", null],
  ["0", "one to one", (viewer) => viewer.oneToOne()],
  ["i", "zoom in", (viewer) => viewer.zoomBy(ZOOM_STEP)],
  ["o", "zoom out", (viewer) => viewer.zoomBy(1 / ZOOM_STEP)],
  ["arrows", "pan, or move the inspector", null],
  ["r", "larger pixels", (viewer) => viewer.stepPixelSize(1)],
  ["R", "smaller pixels", (viewer) => viewer.stepPixelSize(-1)],
  ["c", "sampled, soft, area", (viewer) => viewer.cycle("coverage", COVERAGES)],
  ["w", "wider soft edges", (viewer) => viewer.scaleSoftWidth(1.25)],
  ["W", "narrower soft edges", (viewer) => viewer.scaleSoftWidth(0.8)],
  ["f", "fill rule", (viewer) => viewer.cycle("fill_rule", FILL_RULES)],
  ["m", "shade samples or pixels", (viewer) => viewer.cycle("shading", SHADINGS)],
  ["a", "anisotropy", (viewer) => viewer.cycle("anisotropy", ANISOTROPIES)],
  ["b", "higher level bias", (viewer) => viewer.shiftLodBias(0.25)],
  ["B", "lower level bias", (viewer) => viewer.shiftLodBias(-0.25)],
  ["v", "compare, with a slider", (viewer) => viewer.toggleComparison("slider")],
  ["d", "compare, as difference", (viewer) => viewer.toggleComparison("difference")],
  ["y", "pin these settings", (viewer) => viewer.pinSettings()],
  ["e", "triangle edges", (viewer) => viewer.toggleOverlay("edges")],
  ["t", "tiles", (viewer) => viewer.toggleOverlay("tiles")],
  ["g", "gradients", (viewer) => viewer.toggleOverlay("gradients")],
  ["n", "next file", (viewer) => viewer.showSubject(viewer.current + 1)],
  ["N", "previous file", (viewer) => viewer.showSubject(viewer.current - 1)],
  ["k", "copy the command", (viewer) => viewer.copyCommand()],
  ["h", "hide the panel", (viewer) => viewer.togglePanel()],
  ["Escape", "close what is open", (viewer) => viewer.escape()],
  ["?", "this list", (viewer) => viewer.showHelp()],
];

// ---- Messages ----

// A transport carries messages between a viewer and Python. The viewer calls `send(request)` and
// `close()`. It sets `onmessage(header, payload)`, which receives each reply with its bytes as a
// DataView, and `onclose()`, which is called when Python can no longer be reached. Requests and
// replies are described in `session.py`.

// Opens a transport over a WebSocket. `frames.py` describes the bytes of a message.
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

// Opens a transport over the model of a notebook widget. Several outputs may show one model, each
// with a view of its own, so `owner` says in every message which output it belongs to. Messages
// without an owner are for all outputs.
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

// Returns the numbers of a DataView as an array of a type such as Uint32Array.
function numbersOf(payload, ArrayType) {
  const { buffer, byteOffset, byteLength } = payload;
  const bytesPerNumber = ArrayType.BYTES_PER_ELEMENT;
  if (byteOffset % bytesPerNumber === 0) {
    return new ArrayType(buffer, byteOffset, byteLength / bytesPerNumber);
  }
  // Numbers must begin at a multiple of their length, so these bytes are copied.
  return new ArrayType(buffer.slice(byteOffset, byteOffset + byteLength));
}

// Unpacks a part of a picture, or all of it, into `pixels`, an array with one word per pixel.
// `packed_pixels.py` describes how the pixels are packed: after the bits that say which blocks have
// one colour, there are `colors` such colours, then all pixels of the other blocks, then the pixels
// after the last whole block. Without `blocks`, they are not packed.
function unpackPixels({ blocks, colors }, payload, pixels) {
  const allWords = numbersOf(payload, Uint32Array);
  if (blocks === undefined) {
    pixels.set(allWords);
    return;
  }
  const bitWords = Math.ceil(blocks / 32);
  const bits = new Uint8Array(allWords.buffer, allWords.byteOffset, 4 * bitWords);
  const words = allWords.subarray(bitWords);
  const hasOneColor = (block) => (bits[block >> 3] >> (block & 7)) & 1;
  let [block, nextColor, nextPixel] = [0, 0, colors];
  // Each iteration unpacks a run of blocks: either blocks of one and the same colour, or blocks
  // with several colours each.
  while (block < blocks) {
    const firstBlock = block;
    if (hasOneColor(block)) {
      const color = words[nextColor];
      do {
        block++;
        nextColor++;
      } while (block < blocks && hasOneColor(block) && words[nextColor] === color);
      pixels.fill(color, firstBlock * BLOCK, block * BLOCK);
    } else {
      do block++;
      while (block < blocks && !hasOneColor(block));
      const length = (block - firstBlock) * BLOCK;
      pixels.set(words.subarray(nextPixel, nextPixel + length), firstBlock * BLOCK);
      nextPixel += length;
    }
  }
  pixels.set(words.subarray(nextPixel), blocks * BLOCK);
}

// ---- Helpers ----

// Creates an element: h("div", { class: "name", onclick: listener }, ...children).
function h(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    // The content security policy forbids the attribute `style`, but allows the property.
    else if (name === "style") Object.assign(element.style, value);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value != null) element.setAttribute(name, value);
  }
  // This attribute tells JupyterLab not to treat keys as shortcuts while the element has focus.
  if (/^(button|input|select|summary)$/.test(tag) || "tabindex" in properties) {
    element.setAttribute("data-lm-suppress-shortcuts", "true");
  }
  element.append(...children);
  return element;
}

const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

const isSameView = (a, b) =>
  a && b && ["zoom", "x", "y", "height", "width"].every((name) => a[name] === b[name]);

const percentText = (zoom) => `${+(100 * zoom).toPrecision(3)} %`;

// The CSS notation of a colour with channels from 0 to 1. Without alpha it is opaque.
const cssColor = ([r, g, b, a = 1]) =>
  `rgb(${[r, g, b].map((v) => Math.round(255 * clamp(v, 0, 1))).join(" ")} / ${a})`;

// The CSS notation of an RGBA pixel of bytes.
const cssOfBytes = ([r, g, b, a]) => `rgb(${r} ${g} ${b} / ${a / 255})`;

function coverageText(settings) {
  if (settings.coverage === "soft") return `soft edges, ${+settings.soft_width.toPrecision(2)} px`;
  if (settings.coverage === "area") return "area coverage";
  return settings.samples === 1 ? "1 sample" : `${settings.samples} samples`;
}

let viewerCount = 0;

class Viewer {
  constructor(root, transport, { isWidget = false, still = "" } = {}) {
    this.root = root;
    this.transport = transport;
    this.isWidget = isWidget;
    this.isClosed = false;
    // Radio buttons form groups by name across the document, so each viewer has names of its own.
    this.radioPrefix = `sr${++viewerCount}`;

    this.subjects = [];
    this.current = 0; // Index of the subject that is shown.
    this.settings = { ...DEFAULT_SETTINGS };
    this.pinnedSettings = null;
    // `against` is a name in `COMPARISONS`, "pinned", or "file 2" for the subject of this index.
    this.comparison = { mode: "off", against: "1 sample", split: 0.5 };
    this.overlays = { edges: false, tiles: false, gradients: false };
    this.pixelSize = 1; // Screen pixels per canvas pixel.
    this.view = null; // {zoom, x, y, height, width}, once the stage has a size.
    this.margin = [0, 0]; // Upper left corner of the canvas in the stage, in CSS pixels.
    this.isFitted = false; // Whether the view is still the one that `fitToStage` chose.

    // Slot "a" is the picture of the settings, and slot "b" the one that it is compared with.
    // The last picture of each slot: {canvas, rgba, view, header, id, unused}. `unused` is an array
    // of words for a later picture, because a new array takes longer.
    this.pictures = {};
    this.arriving = {}; // The picture of each slot whose parts are arriving: {id, pixels}.
    this.pictureRequests = {}; // The last request for each slot: {id, key}.
    // Of each kind of overlay, the last request as `key` and `request`, and the last reply as
    // `view`, `header` and `values`.
    this.overlayData = {};
    this.difference = null;
    this.nextId = 1;
    this.oldestPictureId = 0; // Pictures with smaller ids are of another subject.
    this.requestedAt = 0;
    this.isScheduled = false;
    this.error = "";

    this.lens = {
      isOn: false,
      isLocked: false, // A locked lens does not follow the pointer.
      column: 0, // The inspected pixel of the canvas.
      row: 0,
      key: null, // The fields of the last request, as a string.
      request: null, // {id, view} of the last request.
      isWaiting: false, // Whether its report has not arrived.
      report: null, // The samples and triangles of the pixel.
      reference: null, // The value to compare the pixel with, which arrives after the report.
    };

    this.effects = []; // Names of the effects in the plan of the last picture.
    this.costs = new Map(); // Milliseconds by name of the effect.
    this.costId = null;
    this.isMeasuring = false;

    this.build(still);
    transport.onmessage = (header, payload) => this.receive(header, payload);
    transport.onclose = () => this.onClosed();
    this.send("subjects");
  }

  close() {
    this.keyTarget.removeEventListener("keydown", this.keyListener);
    this.resizeObserver.disconnect();
    this.transport.close();
  }

  // ---- Building the page ----

  build(still) {
    const { root } = this;
    root.classList.add("sr-viewer");
    root.classList.toggle("sr-widget", this.isWidget);
    this.stage = this.buildStage(still);
    this.panel = this.buildPanel();
    this.help = this.buildHelp();
    root.append(this.stage, this.panel, this.buildStatus(), this.help);
    this.pictureContext = this.pictureCanvas.getContext("2d", { willReadFrequently: false });
    this.listen();
    this.updateControls();
    this.updateStatus();
  }

  buildStage(still) {
    this.pictureCanvas = h("canvas", { class: "sr-picture", width: 1, height: 1 });
    this.overlayCanvas = h("canvas", { class: "sr-overlay", width: 1, height: 1 });
    this.stillImage = h("img", { class: "sr-still", alt: "", src: still || null, hidden: !still });
    this.splitInput = h("input", {
      type: "range", min: 0, max: 1, step: "any", value: 0.5, "aria-label": "Comparison slider",
      oninput: () => this.moveSplit(+this.splitInput.value),
    });
    this.slider = h("div", { class: "sr-slider", hidden: true }, this.splitInput);
    this.sideNames = [h("span", { class: "sr-side-name" }), h("span", { class: "sr-side-name" })];
    this.bar = this.buildBar();
    this.fitCard = h("div", { class: "sr-card sr-fit", hidden: true });
    this.lensCard = this.buildLens();
    this.toast = h("div", { class: "sr-toast", role: "status", hidden: true });
    return h(
      "div",
      {
        class: "sr-stage", tabindex: 0, role: "application",
        "aria-label": "Picture. Drag to pan, scroll to zoom; press ? for the keys.",
      },
      this.stillImage, this.pictureCanvas, this.overlayCanvas, this.slider, ...this.sideNames,
      this.bar, this.fitCard, this.lensCard, this.toast,
    );
  }

  buildBar() {
    const button = (text, title, onclick) => h("button", { type: "button", title, onclick }, text);
    this.subjectChoice = h("select", {
      "aria-label": "File", onchange: () => this.showSubject(+this.subjectChoice.value),
    });
    this.subjectGroup = h("div", { class: "sr-group", hidden: true }, this.subjectChoice);
    this.pixelSizeChoice = h(
      "select",
      {
        "aria-label": "Screen pixels per pixel of the picture", title: "Pixel size (r, R)",
        onchange: () => this.setPixelSize(+this.pixelSizeChoice.value),
      },
      ...PIXEL_SIZES.map((size) => h("option", { value: size }, `pixels × ${size}`)),
    );
    this.inspectButton = button(
      "Inspect", "Pixel inspector (z)", () => this.isReady() && this.toggleInspector(),
    );
    this.compareButton = button("Compare", "Compare (v)", () => this.toggleComparison("slider"));
    this.panelButton = button("Panel", "Show or hide the panel (h)", () => this.togglePanel());
    return h(
      "div",
      { class: "sr-bar", role: "toolbar", "aria-label": "View" },
      this.subjectGroup,
      h(
        "div", { class: "sr-group" },
        button("−", "Zoom out (o)", () => this.zoomBy(1 / ZOOM_STEP)),
        button("Fit", "Fit the drawing (space)", () => this.fitToStage()),
        button("1:1", "One to one (0)", () => this.oneToOne()),
        button("+", "Zoom in (i)", () => this.zoomBy(ZOOM_STEP)),
      ),
      h("div", { class: "sr-group" }, this.pixelSizeChoice),
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
    const panel = h("aside", { class: "sr-panel", "aria-label": "Settings" });
    // The control of each setting, of each overlay, and of the mode of the comparison.
    this.controls = {};

    // The functions below add to the section that was started last.
    let section = null;
    // Sections about drawings are hidden while an image is shown.
    const startSection = (title, isAboutDrawings) => {
      const className = isAboutDrawings ? "sr-of-drawings" : null;
      section = panel.appendChild(h("section", { class: className }, h("h2", {}, title)));
      return section;
    };
    // Radio buttons for `options`, which are pairs of a value and its text.
    const addChoices = (name, label, options, onchange) => {
      const inputs = options.map(([value, text]) => {
        const input = h("input", {
          type: "radio", name: `${this.radioPrefix}-${name}`, value,
          "aria-label": `${label}: ${text}`, onchange: () => onchange(value),
        });
        return h("label", {}, input, h("span", {}, text));
      });
      this.controls[name] = section.appendChild(h(
        "fieldset", { class: "sr-field" }, h("legend", {}, label),
        h("div", { class: "sr-choices" }, ...inputs),
      ));
    };
    const addSettingChoices = (name, label, options) =>
      addChoices(name, label, options, (value) => this.setSetting(name, value));
    // A slider. `toInput` and `fromInput` convert between the setting and the slider's position.
    const addSlider = (name, label, { limits, step, toText, toInput, fromInput }) => {
      const output = h("output");
      const input = h("input", {
        type: "range", min: toInput(limits[0]), max: toInput(limits[1]), step, "aria-label": label,
        oninput: () => this.setSetting(name, fromInput(+input.value)),
      });
      const field = section.appendChild(h(
        "div", { class: "sr-field" }, h("div", { class: "sr-label" }, label, output), input,
      ));
      field.show = (value) => {
        input.value = toInput(value);
        output.textContent = toText(value);
      };
      this.controls[name] = field;
    };
    const addCheckbox = (name, label, onchange) => {
      const input = h("input", { type: "checkbox", onchange });
      this.controls[name] = section.appendChild(h("label", { class: "sr-check" }, input, label));
    };
    const addHint = () => section.appendChild(h("p", { class: "sr-hint", hidden: true }));
    const withText = (values) => values.map((value) => [value, `${value}`]);

    startSection("Coverage", true);
    addSettingChoices("coverage", "Kind", withText(COVERAGES));
    this.coverageNote = addHint();
    addSettingChoices("samples", "Samples per pixel", withText(SAMPLES));
    addSlider("soft_width", "Width of soft edges", {
      limits: SOFT_WIDTHS,
      step: 0.01,
      toText: (width) => `${+width.toPrecision(2)} px`,
      toInput: (width) => Math.log(width),
      fromInput: (logarithm) => +Math.exp(logarithm).toPrecision(3),
    });
    addSettingChoices(
      "fill_rule", "Fill rule", FILL_RULES.map((rule) => [rule, rule.replace("_", "-")]),
    );
    addSettingChoices("shading", "Shading", SHADINGS.map((unit) => [unit, `per ${unit}`]));

    this.textureSection = startSection("Textures", true);
    addSettingChoices("pixel_filter", "Within a level", withText(PIXEL_FILTERS));
    addSettingChoices("level_filter", "Between levels", withText(LEVEL_FILTERS));
    addSettingChoices("anisotropy", "Anisotropy", withText(ANISOTROPIES));
    addSlider("lod_bias", "Level bias", {
      limits: LOD_BIASES,
      step: 0.25,
      toText: (bias) => `${bias}`,
      toInput: (bias) => bias,
      fromInput: (bias) => bias,
    });

    startSection("Overlays", true);
    addCheckbox("edges", "Triangle edges", () => this.toggleOverlay("edges"));
    addCheckbox("tiles", "Tiles, and how full", () => this.toggleOverlay("tiles"));
    addCheckbox("gradients", "Gradients of positions", () => this.toggleOverlay("gradients"));
    this.tilesNote = addHint();

    startSection("Compare", false);
    addChoices(
      "mode", "Show", withText(["off", "slider", "difference"]),
      (mode) => this.setComparison({ mode }),
    );
    this.againstChoice = h("select", {
      "aria-label": "Compare with",
      onchange: () => this.setComparison({ against: this.againstChoice.value }),
    });
    section.append(h(
      "div", { class: "sr-field" }, h("div", { class: "sr-label" }, "With"), this.againstChoice,
    ));
    this.differenceNote = addHint();

    startSection("Effects", true);
    this.effectList = section.appendChild(h("ul", { class: "sr-effects" }));
    this.measureButton = section.appendChild(h(
      "button", { type: "button", class: "sr-wide", onclick: () => this.measureCosts() },
      "Measure what each costs",
    ));
    this.planText = h("pre");
    section.append(h("details", {}, h("summary", {}, "Plan"), this.planText));
    return panel;
  }

  buildLens() {
    // Each CSS pixel has 2 x 2 pixels of these canvases, for displays of high density.
    this.lensCanvas = h(
      "canvas", { width: 396, height: 396, style: { width: "198px", height: "198px" } },
    );
    this.pixelCanvas = h(
      "canvas", { width: 272, height: 272, style: { width: "136px", height: "136px" } },
    );
    this.lensTitle = h("h3");
    this.lensValues = h("div", { class: "sr-values" });
    this.lensLayers = h("div");
    return h(
      "div",
      {
        class: "sr-card sr-lens", hidden: true, role: "region", "aria-label": "Pixel inspector",
      },
      h(
        "div", { class: "sr-lens-pictures" }, this.lensCanvas,
        h("div", { class: "sr-lens-facts" }, this.pixelCanvas, this.lensTitle),
      ),
      this.lensValues, this.lensLayers,
    );
  }

  buildStatus() {
    this.statusFields = {};
    const addField = (name, isOptional) => {
      this.statusFields[name] = h("span", { class: isOptional ? "sr-optional" : "" });
      return this.statusFields[name];
    };
    return h(
      "footer", { class: "sr-status" }, addField("coverage"), addField("size"), addField("zoom"),
      addField("position", true), h("span", { class: "sr-space" }), addField("notes"),
      addField("time"),
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

  // ---- Input ----

  listen() {
    this.keyTarget = this.isWidget ? this.root : document;
    this.keyListener = (event) => this.onKeyDown(event);
    this.keyTarget.addEventListener("keydown", this.keyListener);
    this.resizeObserver = new ResizeObserver(() => {
      clearTimeout(this.resizeTimer);
      this.resizeTimer = setTimeout(() => this.resize(), this.view ? 160 : 0);
    });
    this.resizeObserver.observe(this.stage);
    const { stage } = this;
    stage.addEventListener("wheel", (event) => this.onWheel(event), { passive: false });
    stage.addEventListener("pointerdown", (event) => this.onPointerDown(event));
    stage.addEventListener("pointermove", (event) => this.onPointerMove(event));
    stage.addEventListener("pointerup", (event) => this.onPointerUp(event));
    stage.addEventListener("pointercancel", (event) => this.onPointerUp(event));
    stage.addEventListener("dblclick", (event) => {
      if (this.isOnPicture(event) && !this.lens.isOn) this.zoomBy(2, this.canvasPoint(event));
    });
    this.pressedPointers = new Map(); // The last position of each, in CSS pixels, by its id.
  }

  onKeyDown(event) {
    const { key, target } = event;
    if (event.ctrlKey || event.metaKey || event.altKey || this.help.open) return;
    if (target.tagName === "SELECT" || (target.tagName === "INPUT" && target.type === "text")) {
      return;
    }
    const isControl = target !== this.stage && /^(INPUT|BUTTON|SUMMARY)$/.test(target.tagName);
    if (isControl && /^( |Enter|Arrow.*)$/.test(key)) return;
    if (!this.isReady() && !["?", "h"].includes(key)) return;
    const direction = {
      ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1],
    }[key];
    // The key of "=" is "+" with Shift on many keyboards.
    const listedKey = key === "+" ? "=" : key;
    const [, , act] = KEYS.find(([name]) => name === listedKey) ?? [];
    if (direction) this.pressArrow(direction, event.shiftKey);
    else if (/^[1-9]$/.test(key)) this.showSubject(+key - 1);
    else if (act) act(this);
    else return;
    event.preventDefault();
    event.stopPropagation();
  }

  pressArrow([x, y], isFast) {
    if (this.lens.isOn) {
      this.lens.isLocked = true;
      const step = isFast ? 10 : 1;
      this.inspect(this.lens.column + x * step, this.lens.row + y * step);
    } else {
      const step = (isFast ? 256 : 64) / this.pixelSize;
      this.panBy(-x * step, -y * step);
    }
  }

  onWheel(event) {
    // In a notebook, scrolling past a widget must not zoom it.
    if (this.isWidget && !this.root.contains(document.activeElement) && !event.ctrlKey) return;
    if (event.target.closest(".sr-lens.sr-locked") || !this.isReady()) return;
    event.preventDefault();
    const pixelsPerUnit = event.deltaMode === 1 ? 16 : 1;
    // Browsers report a pinch on a touchpad as a wheel with Ctrl, in smaller steps.
    const speed = event.ctrlKey ? 0.01 : 0.0015;
    const distance = clamp(event.deltaY * pixelsPerUnit, -400, 400);
    this.zoomBy(Math.exp(-distance * speed), this.canvasPoint(event));
  }

  onPointerDown(event) {
    if (!this.isOnPicture(event) || event.button !== 0 || !this.isReady()) return;
    this.stage.focus({ preventScroll: true });
    this.stage.setPointerCapture(event.pointerId);
    this.pressedPointers.set(event.pointerId, [event.clientX, event.clientY]);
    this.dragLength = 0;
    this.panRemainder = [0, 0];
  }

  // Pans with one pressed pointer, and zooms with two. Without any, the inspector follows.
  onPointerMove(event) {
    if (!this.isReady()) return;
    const before = this.pressedPointers.get(event.pointerId);
    if (!before) {
      if (this.lens.isOn && !this.lens.isLocked && this.isOnPicture(event)) {
        this.inspect(...this.canvasPoint(event).map(Math.floor));
      }
      return;
    }
    const delta = [event.clientX - before[0], event.clientY - before[1]];
    const other = [...this.pressedPointers].find(([id]) => id !== event.pointerId);
    if (other) {
      const [x, y] = other[1];
      const distance = Math.hypot(event.clientX - x, event.clientY - y);
      const distanceBefore = Math.hypot(before[0] - x, before[1] - y);
      const middle = { clientX: (event.clientX + x) / 2, clientY: (event.clientY + y) / 2 };
      this.zoomBy(distance / Math.max(1, distanceBefore), this.canvasPoint(middle));
    } else {
      // Views move by whole canvas pixels. The remainder is added to the next move.
      const scale = this.canvasPixelsPerCssPixel();
      const exactPan = delta.map((d, axis) => d * scale + this.panRemainder[axis]);
      const pan = exactPan.map(Math.round);
      this.panRemainder = exactPan.map((d, axis) => d - pan[axis]);
      if (pan[0] || pan[1]) this.panBy(...pan);
    }
    this.dragLength += Math.abs(delta[0]) + Math.abs(delta[1]);
    this.stage.classList.toggle("sr-dragging", this.dragLength > 3);
    this.pressedPointers.set(event.pointerId, [event.clientX, event.clientY]);
  }

  // A click, which is a press without a drag, locks the inspector at a pixel, or unlocks it.
  onPointerUp(event) {
    if (!this.pressedPointers.delete(event.pointerId)) return;
    this.stage.classList.remove("sr-dragging");
    if (event.type === "pointerup" && this.dragLength <= 3 && this.lens.isOn) {
      this.lens.isLocked = !this.lens.isLocked;
      this.inspect(...this.canvasPoint(event).map(Math.floor));
    }
  }

  isOnPicture(event) {
    return [this.stage, this.pictureCanvas, this.overlayCanvas].includes(event.target);
  }

  // The position of a pointer, in canvas pixels.
  canvasPoint(event) {
    const box = this.stage.getBoundingClientRect();
    const scale = this.canvasPixelsPerCssPixel();
    return [
      (event.clientX - box.left - this.margin[0]) * scale,
      (event.clientY - box.top - this.margin[1]) * scale,
    ];
  }

  canvasPixelsPerCssPixel() {
    return (window.devicePixelRatio || 1) / this.pixelSize;
  }

  // ---- The view ----

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
    // A narrow viewer starts without its panel, which a button opens.
    if (!this.view && !this.panel.hidden && this.root.clientWidth <= NARROW_WIDTH) {
      this.togglePanel();
    }
    // Python compiles a program per canvas size, so the size grows in steps. The stage cuts off
    // what lies outside of it.
    const step = Math.max(2, CANVAS_STEP / this.pixelSize);
    const canvasSide = (cssLength, maxSide) => {
      const steps = Math.ceil((cssLength * ratio) / this.pixelSize / step);
      return clamp(steps * step, step, Math.floor(maxSide / step) * step);
    };
    const width = canvasSide(box.width, MAX_CANVAS_SIDE);
    const maxHeight = Math.min(MAX_CANVAS_SIDE, MAX_CANVAS_PIXELS / width);
    const height = canvasSide(box.height, maxHeight);
    // Canvases begin at a whole screen pixel, so that the browser does not resample them.
    this.margin = [
      Math.floor((box.width * ratio - width * this.pixelSize) / 2) / ratio,
      Math.floor((box.height * ratio - height * this.pixelSize) / 2) / ratio,
    ];
    for (const canvas of [this.pictureCanvas, this.overlayCanvas]) {
      canvas.style.left = `${this.margin[0]}px`;
      canvas.style.top = `${this.margin[1]}px`;
      canvas.style.width = `${(width * this.pixelSize) / ratio}px`;
      canvas.style.height = `${(height * this.pixelSize) / ratio}px`;
    }
    this.slider.style.left = `${this.margin[0]}px`;
    this.slider.style.width = this.pictureCanvas.style.width;
    this.overlayCanvas.width = width * this.pixelSize;
    this.overlayCanvas.height = height * this.pixelSize;
    const { view } = this;
    if (view && view.width === width && view.height === height) {
      this.schedule();
      return;
    }
    this.pictureCanvas.width = width;
    this.pictureCanvas.height = height;
    if (!view || this.isFitted || !this.subjects.length) {
      this.view = { zoom: 1, x: 0, y: 0, height, width };
      this.fitToStage();
    } else {
      this.changeView({
        ...view, height, width,
        x: view.x + (view.width - width) / 2,
        y: view.y + (view.height - height) / 2,
      });
    }
  }

  // Shows a view, with its zoom and offset clamped to what is allowed.
  changeView(view) {
    this.view = {
      ...view,
      zoom: this.clampZoom(view.zoom),
      x: clamp(Math.round(view.x), -MAX_OFFSET, MAX_OFFSET),
      y: clamp(Math.round(view.y), -MAX_OFFSET, MAX_OFFSET),
    };
    this.lens.column = clamp(this.lens.column, 0, view.width - 1);
    this.lens.row = clamp(this.lens.row, 0, view.height - 1);
    this.isFitted = false;
    this.schedule();
  }

  clampZoom(zoom) {
    const { height, width } = this.subject();
    const longerSide = Math.max(height, width);
    return clamp(zoom, MIN_DRAWING_SIDE / longerSide, MAX_DRAWING_SIDE / longerSide);
  }

  // Shows the drawing as large as it fits below the bar.
  fitToStage() {
    if (!this.isReady()) return;
    const { view, bar, stage, margin } = this;
    const { height, width } = this.subject();
    const scale = this.canvasPixelsPerCssPixel();
    const top = (bar.offsetTop + bar.offsetHeight + 8 - margin[1]) * scale;
    const availableWidth = (stage.clientWidth - 24) * scale;
    const availableHeight = (stage.clientHeight - margin[1] - 12) * scale - top;
    const zoom = this.clampZoom(Math.min(availableWidth / width, availableHeight / height));
    this.changeView({
      ...view, zoom,
      x: (width * zoom - view.width) / 2,
      y: (height * zoom - availableHeight) / 2 - top,
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
    const [x, y] = point ?? [view.width / 2, view.height / 2];
    const zoom = this.clampZoom(view.zoom * factor);
    const scale = zoom / view.zoom;
    this.changeView({ ...view, zoom, x: (view.x + x) * scale - x, y: (view.y + y) * scale - y });
  }

  // Moves the drawing by this many canvas pixels.
  panBy(x, y) {
    this.changeView({ ...this.view, x: this.view.x - x, y: this.view.y - y });
  }

  stepPixelSize(step) {
    const index = PIXEL_SIZES.indexOf(this.pixelSize) + step;
    this.setPixelSize(PIXEL_SIZES[clamp(index, 0, PIXEL_SIZES.length - 1)]);
  }

  // Changes how large a canvas pixel is. The drawing keeps its size on the screen.
  setPixelSize(size) {
    if (size === this.pixelSize || !this.isReady()) return;
    const { view } = this;
    const zoom = this.clampZoom(view.zoom * this.pixelSize / size);
    const scale = zoom / view.zoom;
    this.pixelSize = size;
    this.view = {
      ...view, zoom,
      x: Math.round((view.x + view.width / 2) * scale - view.width / 2),
      y: Math.round((view.y + view.height / 2) * scale - view.height / 2),
    };
    this.resize();
    this.updateControls();
  }

  showSubject(index) {
    const count = this.subjects.length;
    if (!count || index < 0 || index >= count || index === this.current) return;
    this.current = index;
    this.overlayData = {};
    this.pictures = {};
    this.pictureRequests = {};
    // Pictures of the last subject may still be on their way.
    this.oldestPictureId = this.nextId;
    this.hideReport();
    this.fitToStage();
    this.updateControls();
    this.updateFitCard();
  }

  // ---- Settings, overlays and comparisons ----

  setSetting(name, value) {
    this.settings = { ...this.settings, [name]: value };
    this.updateControls();
    this.schedule();
  }

  // Changes a setting to the next of its values, and from the last one to the first.
  cycle(name, values) {
    this.setSetting(name, values[(values.indexOf(this.settings[name]) + 1) % values.length]);
  }

  // Changes a setting to a value `step` further on, if there is one.
  stepSetting(name, values, step) {
    const value = values[values.indexOf(this.settings[name]) + step];
    if (value !== undefined) this.setSetting(name, value);
  }

  scaleSoftWidth(factor) {
    const width = clamp(this.settings.soft_width * factor, ...SOFT_WIDTHS);
    this.setSetting("soft_width", +width.toPrecision(3));
  }

  shiftLodBias(step) {
    this.setSetting("lod_bias", clamp(this.settings.lod_bias + step, ...LOD_BIASES));
  }

  toggleOverlay(kind) {
    this.overlays[kind] = !this.overlays[kind];
    if (kind === "gradients" && this.overlays.gradients && this.gradientTarget() === null) {
      this.overlays.gradients = false;
      this.say("Gradients need an image to compare with: open one beside the drawing.");
    }
    this.updateControls();
    this.schedule();
  }

  // The index of the image in the loss whose gradients are shown: the one that is compared with,
  // or else the first one. Null without an image.
  gradientTarget() {
    const index = this.comparedSubject();
    if (index !== null && this.subjects[index]?.is_image) return index;
    const first = this.subjects.findIndex((subject) => subject.is_image);
    return first < 0 ? null : first;
  }

  // The index of the subject that is compared with; null if settings are.
  comparedSubject() {
    const match = /^file (\d+)$/.exec(this.comparison.against);
    return match ? +match[1] : null;
  }

  toggleComparison(mode) {
    this.setComparison({ mode: this.comparison.mode === mode ? "off" : mode });
  }

  setComparison(change) {
    this.comparison = { ...this.comparison, ...change };
    if (change.against && this.comparison.mode === "off") this.comparison.mode = "slider";
    delete this.pictures.b;
    // Without the last request, the picture is requested again, even if only the mode changes.
    delete this.pictureRequests.b;
    this.updateControls();
    this.schedule();
  }

  pinSettings() {
    this.pinnedSettings = { ...this.settings };
    this.updateControls();
    this.setComparison({ against: "pinned" });
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
    else if (this.comparison.mode !== "off") this.setComparison({ mode: "off" });
  }

  showHelp() {
    this.help.showModal();
    // The dialog focuses its button, which is below the list, and scrolls to it.
    this.help.scrollTop = 0;
  }

  // ---- Requests ----

  // Sends a request and returns its id, which the replies repeat.
  send(kind, fields = {}) {
    const id = this.nextId++;
    this.transport.send({ kind, id, ...fields });
    return id;
  }

  // Paints and requests pictures in the next frame, once for all changes until then.
  schedule() {
    this.updateStatus();
    if (this.isScheduled) return;
    this.isScheduled = true;
    requestAnimationFrame(() => {
      this.isScheduled = false;
      this.paint();
      this.requestPictures();
    });
  }

  // Requests the pictures of the current view, unless the last requests were for the same ones.
  requestPictures() {
    if (!this.isReady() || this.isClosed) return;
    let hasRequested = false;
    for (const slot of this.shownSlots()) {
      const fields = this.requestFields(slot);
      const key = JSON.stringify([fields, this.subjects[fields.subject]?.version]);
      if (this.pictureRequests[slot]?.key === key) continue;
      this.pictureRequests[slot] = { id: this.send("picture", fields), key };
      this.requestedAt = performance.now();
      hasRequested = true;
    }
    if (hasRequested) {
      this.setState("pending");
      // The costs that are shown belong to the last picture.
      this.cancelCosts();
    } else if (this.isExact()) this.onExact();
    clearTimeout(this.busyTimer);
    this.busyTimer = setTimeout(() => this.updateStatus(), BUSY_MS + 10);
  }

  // The fields of a request for the picture in a slot.
  requestFields(slot = "a") {
    const fields = {
      slot, subject: this.current, view: { ...this.view }, settings: this.settings,
    };
    if (slot === "a") return fields;
    const { against } = this.comparison;
    const subject = this.comparedSubject();
    if (subject !== null) fields.subject = subject;
    else if (against === "pinned") fields.settings = this.pinnedSettings;
    else fields.settings = { ...this.settings, ...COMPARISONS[against] };
    return fields;
  }

  shownSlots() {
    return this.comparison.mode === "off" ? ["a"] : ["a", "b"];
  }

  // Whether the pictures that are shown are those that were requested last.
  isExact() {
    return this.shownSlots().every((slot) => {
      const picture = this.pictures[slot];
      return picture && picture.id === this.pictureRequests[slot]?.id &&
        isSameView(picture.view, this.view);
    });
  }

  // Once the exact picture is shown, requests its overlays and the report of the inspector.
  onExact() {
    this.setState("exact");
    for (const kind of ["edges", "tiles", "gradients"]) {
      if (!this.overlays[kind] || this.subject().is_image) continue;
      const fields = { ...this.requestFields(), slot: kind };
      if (kind === "gradients") fields.target = this.gradientTarget();
      const key = JSON.stringify([fields, this.subject().version]);
      if (this.overlayData[kind]?.key === key) continue;
      const request = { id: this.send(kind, fields), view: fields.view };
      this.overlayData[kind] = { ...this.overlayData[kind], key, request };
    }
    if (this.lens.isOn) this.requestReport();
  }

  // Sets the state of the picture: "pending", "exact", "error" or "closed".
  setState(state) {
    this.root.dataset.state = state;
    this.updateStatus();
  }

  // ---- Replies ----

  receive(header, payload) {
    const handlers = {
      error: () => this.onError(header),
      subjects: () => this.onSubjects(header),
      changed: () => this.send("subjects"),
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
    subjects.forEach((subject, index) => {
      const { height, width } = this.subjects[index] ?? subject;
      if (subject.error) Object.assign(subject, { height, width });
    });
    this.subjects = subjects;
    const subject = this.subject();
    this.subjectGroup.hidden = subjects.length < 2;
    this.subjectChoice.replaceChildren(
      ...subjects.map(({ name }, index) => h("option", { value: index }, `${index + 1}  ${name}`)),
    );
    if (!this.isWidget) document.title = `${subject.name} – softras2d`;
    this.updateComparisonChoice();
    if (isFirst) {
      // While a fit runs, its triangles are shown over the picture.
      this.overlays.edges = Boolean(subject.fit?.is_running);
      this.fitToStage();
    } else if (before.height !== subject.height || before.width !== subject.width) {
      this.fitToStage();
    }
    this.updateControls();
    this.updateFitCard();
    this.schedule();
  }

  onPicture(header, payload) {
    const { slot, height, width } = header;
    const previous = this.pictures[slot];
    if (header.id < this.oldestPictureId || (previous && previous.id > header.id)) return;
    if (this.arriving[slot]?.id !== header.id) {
      const size = width * height;
      const unused = previous?.unused;
      const pixels = unused?.length === size ? unused : new Uint32Array(size);
      this.arriving[slot] = { id: header.id, pixels };
    }
    const { pixels } = this.arriving[slot];
    // Only the page of the server receives parts; in a notebook, a picture is one message.
    unpackPixels(header, payload, pixels.subarray(header.first_pixel ?? 0));
    if (header.is_last === false) return;
    delete this.arriving[slot];
    const rgba = new Uint8ClampedArray(pixels.buffer);
    let canvas = previous?.canvas;
    if (!canvas || canvas.width !== width || canvas.height !== height) {
      canvas = new OffscreenCanvas(width, height);
    }
    canvas.getContext("2d").putImageData(new ImageData(rgba, width, height), 0, 0);
    const unused = previous && new Uint32Array(previous.rgba.buffer);
    this.pictures[slot] = { canvas, rgba, view: header.view, header, id: header.id, unused };
    if (header.id === this.pictureRequests[slot]?.id) this.error = "";
    this.stillImage.hidden = true;
    if (slot === "a") this.updatePlan(header);
    this.paint();
    if (this.isExact()) {
      // Read by `experiments/viewer`.
      this.root.dataset.drawnMs = (performance.now() - this.requestedAt).toFixed(1);
      this.onExact();
    }
  }

  onOverlay(header, payload, ArrayType) {
    const data = this.overlayData[header.kind];
    if (data?.request?.id !== header.id) return;
    const values = numbersOf(payload, ArrayType);
    this.overlayData[header.kind] = { ...data, view: data.request.view, header, values };
    this.paint();
    this.updateStatus();
  }

  onError({ request, message, slot, id }) {
    if (request === "picture") {
      if (id !== this.pictureRequests[slot]?.id) return;
      this.error = message;
      this.setState("error");
    } else if (request === "inspect") {
      if (id !== this.lens.request?.id) return;
      const { key } = this.lens;
      this.hideReport();
      // With its key, the same request is not sent again: it would fail again.
      this.lens.key = key;
    } else if (request === "gradients" || request === "tiles" || request === "edges") {
      if (id !== this.overlayData[request]?.request?.id) return;
      this.overlays[request] = false;
      this.updateControls();
    } else if (request === "costs") {
      if (id !== this.costId) return;
      this.cancelCosts();
    }
    this.say(message);
  }

  onClosed() {
    this.isClosed = true;
    this.setState("closed");
  }

  // ---- Saving and copying ----

  save() {
    if (!this.isReady()) return;
    if (this.comparison.mode === "off") {
      this.send("png", this.requestFields());
      return;
    }
    // A comparison exists only on the page, so it is saved as it is shown.
    this.pictureCanvas.toBlob((blob) => this.download(blob, this.subject().name, "comparison"));
  }

  onPng({ name }, payload) {
    this.download(new Blob([payload], { type: "image/png" }), name, "view");
  }

  download(blob, name, suffix) {
    const url = URL.createObjectURL(blob);
    h("a", { href: url, download: `${name.replace(/\.[^.]*$/, "")}-${suffix}.png` }).click();
    // Browsers read the data some time after the click.
    setTimeout(() => URL.revokeObjectURL(url), 1e4);
  }

  async copyCommand() {
    const command = this.pictures.a?.header.command;
    if (!command) {
      this.say("There is no command for this.");
      return;
    }
    try {
      await navigator.clipboard.writeText(command);
      this.say(`Copied: ${command}`);
    } catch {
      // Browsers may deny access to the clipboard. The text can be selected instead.
      this.say(command);
    }
  }

  // ---- Painting ----

  paint() {
    if (!this.view) return;
    const { pictureContext: context, comparison } = this;
    const { a, b } = this.pictures;
    const { width } = this.view;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, this.pictureCanvas.width, this.pictureCanvas.height);
    if (comparison.mode === "difference" && a && b && isSameView(a.view, b.view)) {
      this.paintDifference(a, b);
    } else if (comparison.mode === "slider") {
      const split = Math.round(comparison.split * width);
      this.paintPicture(a, 0, split);
      this.paintPicture(b ?? a, split, width);
    } else {
      this.paintPicture(a, 0, width);
    }
    this.paintOverlays();
  }

  // Paints a picture, moved and scaled to the view, between two columns of the canvas.
  paintPicture(picture, left, right) {
    if (!picture || right <= left) return;
    const { pictureContext: context, view } = this;
    context.save();
    context.beginPath();
    context.rect(left, 0, right - left, view.height);
    context.clip();
    if (!isSameView(picture.view, view)) {
      const [scale, x, y] = this.transformFrom(picture.view);
      context.imageSmoothingEnabled = scale < 1;
      context.setTransform(scale, 0, 0, scale, x, y);
    }
    context.drawImage(picture.canvas, 0, 0);
    context.restore();
  }

  // Scale and translation, in canvas pixels, from an earlier view to the current one.
  transformFrom(view) {
    const scale = this.view.zoom / view.zoom;
    return [scale, view.x * scale - this.view.x, view.y * scale - this.view.y];
  }

  paintDifference(a, b) {
    const key = `${a.id} ${b.id}`;
    if (this.difference?.key !== key) this.difference = { key, ...this.computeDifference(a, b) };
    const { canvas, largest, differing, pixels } = this.difference;
    this.differenceNote.textContent =
      `${differing.toLocaleString("en")} of ${pixels.toLocaleString("en")} pixels differ, by ` +
      `${largest} of 255 at most. Shown × ${DIFFERENCE_GAIN}.`;
    this.paintPicture({ canvas, view: a.view }, 0, this.view.width);
  }

  // A picture of the difference of two pictures, how many pixels differ, and by how much at most.
  // A difference in alpha is counted, but not shown.
  computeDifference(a, b) {
    const { width, height } = a.canvas;
    const image = new ImageData(width, height);
    let [largest, differing] = [0, 0];
    for (let index = 0; index < image.data.length; index += 4) {
      let largestOfPixel = Math.abs(a.rgba[index + 3] - b.rgba[index + 3]);
      for (let channel = 0; channel < 3; channel++) {
        const difference = Math.abs(a.rgba[index + channel] - b.rgba[index + channel]);
        image.data[index + channel] = DIFFERENCE_GAIN * difference;
        if (difference > largestOfPixel) largestOfPixel = difference;
      }
      image.data[index + 3] = 255;
      if (largestOfPixel) differing++;
      if (largestOfPixel > largest) largest = largestOfPixel;
    }
    const canvas = new OffscreenCanvas(width, height);
    canvas.getContext("2d").putImageData(image, 0, 0);
    return { canvas, largest, differing, pixels: width * height };
  }

  // Paints what lies over the picture. The canvas of overlays has one pixel per screen pixel.
  paintOverlays() {
    const context = this.overlayCanvas.getContext("2d", { willReadFrequently: false });
    const { pixelSize } = this;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, this.overlayCanvas.width, this.overlayCanvas.height);
    this.paintFrame(context);
    if (pixelSize >= 8) this.paintPixelGrid(context);
    const painters = [
      ["tiles", (data, scale) => this.paintTiles(context, data, scale)],
      ["edges", (data, scale) => this.paintEdges(context, data, scale)],
      ["gradients", (data, scale) => this.paintGradients(context, data, scale)],
    ];
    for (const [kind, paint] of painters) {
      const data = this.overlayData[kind];
      if (!this.overlays[kind] || !data?.values) continue;
      // Overlays are drawn in canvas pixels of the view that they were requested for.
      const [scale, x, y] = this.transformFrom(data.view);
      const screenScale = scale * pixelSize;
      context.setTransform(screenScale, 0, 0, screenScale, x * pixelSize, y * pixelSize);
      // Line styles of one overlay must not reach the next frame.
      context.save();
      paint(data, screenScale);
      context.restore();
    }
    context.setTransform(1, 0, 0, 1, 0, 0);
    if (this.comparison.mode === "slider") this.paintSplit(context);
    if (this.lens.isOn) this.paintInspectedPixel(context);
  }

  // Outlines the drawing, and dims what lies outside of it.
  paintFrame(context) {
    if (!this.subjects.length) return;
    const { view, pixelSize } = this;
    const { width, height } = this.subject();
    const frame = [
      -view.x * pixelSize, -view.y * pixelSize,
      Math.round(width * view.zoom) * pixelSize, Math.round(height * view.zoom) * pixelSize,
    ];
    context.beginPath();
    context.rect(0, 0, this.overlayCanvas.width, this.overlayCanvas.height);
    context.rect(...frame);
    context.fillStyle = "rgb(128 128 128 / 30%)";
    context.fill("evenodd");
    context.strokeStyle = "rgb(128 128 128 / 60%)";
    context.lineWidth = 1;
    context.strokeRect(frame[0] - 0.5, frame[1] - 0.5, frame[2] + 1, frame[3] + 1);
  }

  paintPixelGrid(context) {
    const { pixelSize } = this;
    const { width, height } = this.view;
    context.beginPath();
    for (let x = 1; x < width; x++) context.rect(x * pixelSize, 0, 0, height * pixelSize);
    for (let y = 1; y < height; y++) context.rect(0, y * pixelSize, width * pixelSize, 0);
    context.strokeStyle = "rgb(128 128 128 / 35%)";
    context.lineWidth = 1;
    context.stroke();
  }

  // The painters of overlays draw in canvas pixels; `scale` is how many screen pixels one is wide.

  // Shades each tile by how many triangles it lists, and writes the number on it if it is large
  // enough on the screen.
  paintTiles(context, { header, values }, scale) {
    const { rows, columns, tile_width: width, tile_height: height, max: most } = header;
    const hasNumbers = Math.min(width, height) * scale >= 22;
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.font = `${11 / scale}px system-ui, sans-serif`;
    for (let row = 0; row < rows; row++) {
      for (let column = 0; column < columns; column++) {
        const count = values[row * columns + column];
        if (!count) continue;
        // The square root keeps short lists apart where a few are very long.
        const fullness = Math.sqrt(count / Math.max(most, 1));
        const rgb = [190 + 60 * fullness, 120 - 70 * fullness, 20 + 60 * (1 - fullness)];
        context.fillStyle = `rgb(${rgb.map(Math.round).join(" ")} / ${0.12 + 0.55 * fullness})`;
        context.fillRect(column * width, row * height, width, height);
        if (hasNumbers) {
          context.fillStyle = "#000";
          context.fillText(count, (column + 0.5) * width, (row + 0.5) * height);
        }
      }
    }
    context.beginPath();
    for (let column = 0; column <= columns; column++) {
      context.moveTo(column * width, 0);
      context.lineTo(column * width, rows * height);
    }
    for (let row = 0; row <= rows; row++) {
      context.moveTo(0, row * height);
      context.lineTo(columns * width, row * height);
    }
    context.lineWidth = 1 / scale;
    context.strokeStyle = "rgb(90 60 30 / 30%)";
    context.stroke();
  }

  // Draws the outlines of triangles. Each triangle has six values: the x and y of its corners.
  paintEdges(context, { values }, scale) {
    context.beginPath();
    for (let index = 0; index < values.length; index += 6) {
      context.moveTo(values[index], values[index + 1]);
      context.lineTo(values[index + 2], values[index + 3]);
      context.lineTo(values[index + 4], values[index + 5]);
      context.closePath();
    }
    context.lineJoin = "bevel";
    // A light line below the dark one makes edges visible on any colour.
    context.lineWidth = 2.2 / scale;
    context.strokeStyle = "rgb(255 255 255 / 28%)";
    context.stroke();
    context.lineWidth = 0.9 / scale;
    context.strokeStyle = "rgb(20 24 30 / 80%)";
    context.stroke();
  }

  // Draws an arrow at each vertex along its negative gradient, the direction in which gradient
  // descent would move it. Each vertex has four values: x, y, and the derivatives with respect to
  // them.
  paintGradients(context, { values }, scale) {
    let longest = 0;
    for (let index = 0; index < values.length; index += 4) {
      longest = Math.max(longest, Math.hypot(values[index + 2], values[index + 3]));
    }
    if (!longest) return;
    const lengthPerGradient = MAX_ARROW_LENGTH / scale / longest;
    const maxHeadLength = 6 / scale;
    for (const [width, color] of [[3.5, "rgb(255 255 255 / 80%)"], [1.6, "#b3261e"]]) {
      context.beginPath();
      for (let index = 0; index < values.length; index += 4) {
        const [x, y] = [values[index], values[index + 1]];
        const dx = -values[index + 2] * lengthPerGradient;
        const dy = -values[index + 3] * lengthPerGradient;
        const length = Math.hypot(dx, dy);
        if (length < 1.5 / scale) continue;
        const [ux, uy] = [dx / length, dy / length];
        const [tipX, tipY] = [x + dx, y + dy];
        const head = Math.min(maxHeadLength, length / 2);
        context.moveTo(x, y);
        context.lineTo(tipX, tipY);
        context.moveTo(tipX - head * (ux + 0.5 * uy), tipY - head * (uy - 0.5 * ux));
        context.lineTo(tipX, tipY);
        context.lineTo(tipX - head * (ux - 0.5 * uy), tipY - head * (uy + 0.5 * ux));
      }
      context.lineWidth = width / scale;
      context.strokeStyle = color;
      context.stroke();
    }
  }

  // Paints the line between the two pictures of a comparison.
  paintSplit(context) {
    const x = Math.round(this.comparison.split * this.view.width) * this.pixelSize;
    context.fillStyle = "rgb(0 0 0 / 55%)";
    context.fillRect(x - 1, 0, 2, this.overlayCanvas.height);
    context.fillStyle = "rgb(255 255 255 / 75%)";
    context.fillRect(x, 0, 1, this.overlayCanvas.height);
  }

  paintInspectedPixel(context) {
    const { lens, pixelSize } = this;
    const box = [
      lens.column * pixelSize - 1.5, lens.row * pixelSize - 1.5, pixelSize + 3, pixelSize + 3,
    ];
    context.lineWidth = 3;
    context.strokeStyle = "rgb(0 0 0 / 70%)";
    context.strokeRect(...box);
    context.lineWidth = 1;
    context.strokeStyle = "#fff";
    context.strokeRect(...box);
  }

  // ---- The pixel inspector ----

  toggleInspector() {
    const { lens } = this;
    if (!lens.isOn && this.subject().is_image) {
      this.say("An image has no samples to inspect.");
      return;
    }
    lens.isOn = !lens.isOn;
    this.stage.classList.toggle("sr-inspecting", lens.isOn);
    if (lens.isOn) {
      lens.isLocked = false;
      this.inspect(Math.floor(this.view.width / 2), Math.floor(this.view.height / 2));
    } else {
      this.hideReport();
    }
    this.updateControls();
    this.paint();
  }

  inspect(column, row) {
    const { lens, view } = this;
    lens.column = clamp(column, 0, view.width - 1);
    lens.row = clamp(row, 0, view.height - 1);
    this.paint();
    this.placeLens();
    this.requestReport();
  }

  // Requests the report of the inspected pixel, but one at a time: when a report arrives, the next
  // one is requested for the pixel that the pointer has reached by then.
  requestReport() {
    const { lens } = this;
    if (!lens.isOn || this.subject().is_image) return;
    const fields = { ...this.requestFields(), slot: "lens", column: lens.column, row: lens.row };
    const key = JSON.stringify([fields, this.subject().version]);
    if (lens.key === key || lens.isWaiting || this.root.dataset.state !== "exact") return;
    lens.key = key;
    lens.isWaiting = true;
    lens.request = { id: this.send("inspect", fields), view: fields.view };
  }

  onReport(header, payload) {
    const { lens } = this;
    if (header.id !== lens.request?.id) return;
    lens.isWaiting = false;
    if (!lens.isOn) return;
    const { buffer, byteOffset, byteLength } = payload;
    const bytes = new Uint8ClampedArray(buffer, byteOffset, byteLength);
    lens.report = { ...header, view: lens.request.view, bytes };
    lens.reference = null;
    this.showReport();
    this.requestReport();
  }

  onReference(header) {
    const { lens } = this;
    if (header.id !== lens.report?.id) return;
    lens.reference = header;
    this.showPixelValues();
  }

  hideReport() {
    Object.assign(this.lens, {
      key: null, request: null, isWaiting: false, report: null, reference: null,
    });
    this.lensCard.hidden = true;
  }

  // In a report, `lens` is the number of pixels along a side of the lens, and `rate` the number of
  // samples along a side of a pixel. `bytes` are the RGBA of all samples of the lens, row by row.
  showReport() {
    const { report } = this.lens;
    this.lensCard.hidden = false;
    this.paintLens(report);
    this.paintSamples(report);
    this.lensTitle.textContent =
      `Pixel ${report.column + report.view.x}, ${report.row + report.view.y}`;
    this.lensTitle.title = report.rate > 1 ? `${report.rate ** 2} samples` : "1 sample";
    this.showPixelValues();
    this.showLayers(report);
    this.placeLens();
  }

  // Moves the card of the inspector beside the inspected pixel, to a side on which it fits.
  placeLens() {
    const { lens, lensCard } = this;
    lensCard.classList.toggle("sr-locked", lens.isLocked);
    if (!lens.report) return;
    const stageBox = this.stage.getBoundingClientRect();
    const scale = this.canvasPixelsPerCssPixel();
    const x = this.margin[0] + (lens.column + 0.5) / scale;
    const y = this.margin[1] + (lens.row + 0.5) / scale;
    const [width, height] = [lensCard.offsetWidth, lensCard.offsetHeight];
    // After the pixel, or else before it; at least 6 CSS pixels from the border of the stage.
    const beside = (center, length, stageLength) => {
      const after = center + 26;
      return after + length < stageLength - 6 ? after : Math.max(6, center - 26 - length);
    };
    const left = beside(x, width, stageBox.width);
    const isBeside = left > x || left + width < x;
    const top = isBeside
      ? clamp(y - height / 2, 6, Math.max(6, stageBox.height - height - 6))
      : beside(y, height, stageBox.height);
    lensCard.style.left = `${left}px`;
    lensCard.style.top = `${top}px`;
  }

  // Paints the pixels around the inspected one, with the colours of their samples.
  paintLens(report) {
    const { lens: pixels, rate } = report;
    const { width: length } = this.lensCanvas;
    const context = this.lensCanvas.getContext("2d");
    const side = length / pixels;
    const middle = (pixels - 1) / 2;
    context.clearRect(0, 0, length, length);
    const picture = isSameView(this.pictures.a?.view, report.view) ? this.pictures.a : null;
    if (picture) {
      const { width, height } = picture.canvas;
      for (let row = 0; row < pixels; row++) {
        for (let column = 0; column < pixels; column++) {
          const [x, y] = [report.column - middle + column, report.row - middle + row];
          if (x < 0 || y < 0 || x >= width || y >= height) continue;
          const start = 4 * (y * width + x);
          context.fillStyle = cssOfBytes(picture.rgba.subarray(start, start + 4));
          context.fillRect(column * side, row * side, side, side);
        }
      }
    }
    // With more than 4 x 4 samples per pixel, they would be too small to see.
    if (rate <= 4) {
      const columns = pixels * rate;
      const spacing = side / rate;
      for (let sample = 0; sample < columns * columns; sample++) {
        const x = ((sample % columns) + 0.5) * spacing;
        const y = (Math.floor(sample / columns) + 0.5) * spacing;
        context.beginPath();
        context.arc(x, y, Math.min(0.3 * spacing, 6), 0, 2 * Math.PI);
        context.fillStyle = cssOfBytes(report.bytes.subarray(4 * sample, 4 * sample + 4));
        context.fill();
        context.lineWidth = 0.75;
        context.strokeStyle = "rgb(128 128 128 / 60%)";
        context.stroke();
      }
    }
    context.beginPath();
    for (let line = 0; line <= pixels; line++) {
      context.moveTo(line * side, 0);
      context.lineTo(line * side, length);
      context.moveTo(0, line * side);
      context.lineTo(length, line * side);
    }
    context.lineWidth = 1;
    context.strokeStyle = "rgb(128 128 128 / 50%)";
    context.stroke();
    this.paintTriangles(context, report, side, 0, pixels);
    for (const [width, color] of [[5, "rgb(0 0 0 / 65%)"], [2, "#fff"]]) {
      context.lineWidth = width;
      context.strokeStyle = color;
      context.strokeRect(middle * side, middle * side, side, side);
    }
  }

  // Paints the inspected pixel alone: its samples over the edges of the triangles that cover it.
  paintSamples(report) {
    const { lens: pixels, rate } = report;
    const context = this.pixelCanvas.getContext("2d");
    const margin = 8;
    const side = this.pixelCanvas.width - 2 * margin;
    context.clearRect(0, 0, this.pixelCanvas.width, this.pixelCanvas.height);
    context.fillStyle = cssColor(report.value);
    context.fillRect(margin, margin, side, side);
    context.strokeStyle = "rgb(128 128 128 / 80%)";
    context.lineWidth = 1;
    context.strokeRect(margin, margin, side, side);
    context.save();
    context.translate(margin, margin);
    this.paintTriangles(context, report, side, (pixels - 1) / 2, 1);
    const spacing = side / rate;
    report.samples.forEach(({ triangle, color }, sample) => {
      const isCovered = triangle >= 0;
      const x = ((sample % rate) + 0.5) * spacing;
      const y = (Math.floor(sample / rate) + 0.5) * spacing;
      context.beginPath();
      context.arc(x, y, Math.min(0.32 * spacing, 22), 0, 2 * Math.PI);
      context.fillStyle = cssColor(color);
      context.fill();
      context.lineWidth = isCovered ? 2 : 1;
      context.setLineDash(isCovered ? [] : [3, 3]);
      context.strokeStyle = "rgb(30 30 30 / 75%)";
      context.stroke();
    });
    context.restore();
  }

  // Paints the triangles of a report, clipped to a square of the pixels of the lens. The square
  // begins at row and column `first`, and has `pixels` pixels along a side, each painted `side`
  // wide.
  paintTriangles(context, report, side, first, pixels) {
    context.save();
    context.beginPath();
    context.rect(0, 0, pixels * side, pixels * side);
    context.clip();
    context.beginPath();
    for (const { corners } of report.edges) {
      corners.forEach(([x, y], corner) => {
        // Corners may lie much further away than a canvas can draw to.
        const point = [x, y].map((value) => clamp((value - first) * side, -1e5, 1e5));
        context[corner ? "lineTo" : "moveTo"](...point);
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

  // Lists the value of the pixel as it is drawn, and the reference value once it is known.
  showPixelValues() {
    const { report, reference } = this.lens;
    const row = (name, value) => [
      h("span", { class: "sr-swatch", style: { background: cssColor(value) } }),
      h("span", {}, name),
      h("span", {}, value.map((v) => v.toFixed(4)).join("  ")),
    ];
    const referenceRow = reference
      ? row(reference.name, reference.value)
      : [h("span"), h("span", {}, "exact …"), h("span")];
    this.lensValues.replaceChildren(...row("drawn", report.value), ...referenceRow);
  }

  // Lists the triangles that cover the inspected pixel.
  showLayers({ layers, rate, samples, most_layers: maxLayers }) {
    if (!layers.length) {
      const hint = h("p", { class: "sr-hint" }, "No triangle covers this pixel.");
      this.lensLayers.replaceChildren(hint);
      return;
    }
    // Analytic coverage has no samples.
    const isSampled = samples.length > 0;
    const has = (name) => layers.some((layer) => layer[name] != null);
    const swatch = (color) =>
      h("span", { class: "sr-swatch", style: { background: cssColor(color) } });
    const coverage = (layer) =>
      isSampled ? `${new Set(layer.samples).size} / ${rate ** 2}` : layer.coverage.toFixed(3);
    const columns = [
      ["triangle", ({ triangle, color }) => [swatch(color), ` ${triangle}`]],
      ["covers", coverage],
      ["weights", ({ weights }) => weights.map((w) => w.toFixed(2)).join(" ")],
      ...(has("depth") ? [["depth", ({ depth }) => depth.toFixed(4)]] : []),
      ...(has("uv") ? [["u, v", ({ uv }) => uv.map((t) => t.toFixed(3)).join(" ")]] : []),
      ...(has("level") ? [["level", ({ level }) => level?.toFixed(2) ?? "none"]] : []),
    ];
    const table = h(
      "table", {},
      h("thead", {}, h("tr", {}, ...columns.map(([name]) => h("th", { scope: "col" }, name)))),
      h("tbody", {}, ...layers.slice(0, MAX_LISTED_LAYERS).map((layer) =>
        h("tr", {}, ...columns.map(([, cell]) => h("td", {}, ...[cell(layer)].flat()))))),
    );
    const hints = [];
    if (layers.length > MAX_LISTED_LAYERS || layers.length >= maxLayers) {
      hints.push("Nearest first; there may be more behind.");
    }
    if (!isSampled && this.effects.includes("texture")) hints.push("Colours without texture.");
    this.lensLayers.replaceChildren(
      table, ...hints.map((text) => h("p", { class: "sr-hint" }, text)),
    );
  }

  // ---- Costs of effects ----

  measureCosts() {
    if (!this.isReady()) return;
    this.costs.clear();
    this.isMeasuring = true;
    this.costId = this.send("costs", { ...this.requestFields(), slot: "costs" });
    this.updateEffects();
  }

  onCost(header) {
    if (header.id !== this.costId) return;
    // The reply for the complete scene has no effect.
    if (header.effect) {
      this.costs.set(header.effect, header.milliseconds - header.milliseconds_without);
    }
    if (header.is_last) this.isMeasuring = false;
    this.updateEffects();
  }

  // Forgets the costs of effects. Replies still to come are ignored.
  cancelCosts() {
    this.costs.clear();
    this.costId = null;
    this.isMeasuring = false;
    this.updateEffects();
  }

  updateEffects() {
    const row = (name) => {
      const cost = this.costs.get(name);
      const text = cost ? `${cost >= 0 ? "+" : "−"}${Math.abs(cost).toFixed(1)} ms` : "";
      return h("li", {}, h("span", {}, name), h("span", {}, text));
    };
    const rows = this.effects.length ? this.effects.map(row) : [h("li", {}, "none")];
    this.effectList.replaceChildren(...rows);
    this.measureButton.disabled = this.isMeasuring;
    this.measureButton.textContent = this.isMeasuring ? "Measuring …" : "Measure what each costs";
    this.measureButton.hidden = !this.effects.length;
  }

  // ---- Panel, progress of a fit, status line and messages ----

  updateControls() {
    const { controls, settings, comparison } = this;
    const checkChoice = (name, value) => {
      for (const input of controls[name].querySelectorAll("input")) {
        input.checked = input.value === `${value}`;
      }
    };
    for (const [name, value] of Object.entries(settings)) {
      if (controls[name].show) controls[name].show(value);
      else checkChoice(name, value);
    }
    const isSampled = settings.coverage === "sampled";
    this.coverageNote.hidden = isSampled;
    this.coverageNote.textContent = COVERAGE_NOTES[settings.coverage];
    for (const name of ["samples", "fill_rule", "shading"]) controls[name].hidden = !isSampled;
    controls.soft_width.hidden = settings.coverage !== "soft";

    for (const [kind, isOn] of Object.entries(this.overlays)) {
      controls[kind].querySelector("input").checked = isOn;
    }
    this.tilesNote.hidden = !(this.overlays.tiles && this.overlayData.tiles?.header);

    checkChoice("mode", comparison.mode);
    this.updateComparisonChoice();
    this.differenceNote.hidden = comparison.mode !== "difference";
    for (const element of [this.slider, ...this.sideNames]) {
      element.hidden = comparison.mode !== "slider";
    }
    this.sideNames[0].textContent = coverageText(settings);
    this.sideNames[1].textContent = this.againstChoice.selectedOptions[0]?.textContent ?? "";

    this.panel.classList.toggle("sr-of-image", Boolean(this.subject()?.is_image));
    this.subjectChoice.value = this.current;
    this.pixelSizeChoice.value = this.pixelSize;
    this.inspectButton.setAttribute("aria-pressed", this.lens.isOn);
    this.compareButton.setAttribute("aria-pressed", comparison.mode !== "off");
    this.panelButton.setAttribute("aria-pressed", !this.panel.hidden);
    this.updateEffects();
  }

  // Lists what the picture can be compared with. A choice that has gone is replaced.
  updateComparisonChoice() {
    const { comparison } = this;
    const options = Object.keys(COMPARISONS).map((name) => [name, name]);
    if (this.pinnedSettings) options.push(["pinned", "pinned settings"]);
    this.subjects.forEach(({ name }, index) => {
      if (index !== this.current) options.push([`file ${index}`, name]);
    });
    if (!options.some(([value]) => value === comparison.against)) comparison.against = "1 sample";
    this.againstChoice.replaceChildren(
      ...options.map(([value, text]) => h("option", { value }, text)),
    );
    this.againstChoice.value = comparison.against;
  }

  updatePlan(header) {
    this.planText.textContent = header.plan;
    const effects = header.effects ?? [];
    if (`${effects}` !== `${this.effects}`) {
      this.effects = effects;
      this.updateEffects();
    }
    this.textureSection.hidden = !effects.includes("texture");
  }

  // Shows the progress of a fit: its PSNR over time, as a curve.
  updateFitCard() {
    const fit = this.subject()?.fit;
    this.fitCard.hidden = !fit || fit.history.length < 2;
    if (this.fitCard.hidden) return;
    const { history } = fit;
    const seconds = history.map((row) => row[1]);
    const psnr = history.map((row) => row[2]);
    const [low, high] = [Math.min(...psnr), Math.max(...psnr)];
    const [first, last] = [seconds[0], Math.max(seconds.at(-1), seconds[0] + 1e-3)];
    const points = history.map(([, time, value]) => {
      const x = (100 * (time - first)) / (last - first);
      const y = 60 - (56 * (value - low)) / Math.max(high - low, 1e-6);
      return `${x},${y}`;
    });
    const svgNamespace = "http://www.w3.org/2000/svg";
    const svg = document.createElementNS(svgNamespace, "svg");
    svg.setAttribute("viewBox", "0 0 100 62");
    svg.setAttribute("preserveAspectRatio", "none");
    svg.setAttribute("role", "img");
    const range = `${psnr[0].toFixed(1)} to ${psnr.at(-1).toFixed(1)} dB`;
    svg.setAttribute("aria-label", `PSNR from ${range}`);
    const curve = document.createElementNS(svgNamespace, "polyline");
    curve.setAttribute("points", points.join(" "));
    svg.append(curve);
    const [steps, time, value, triangles] = history.at(-1);
    const state = fit.is_running ? "fitting" : "fitted";
    const decibels = h("strong", {}, `${value.toFixed(2)} dB`);
    this.fitCard.replaceChildren(
      h("div", { class: "sr-label" }, `${state}, ${triangles} triangles`, decibels),
      svg,
      h("div", { class: "sr-label" }, `step ${steps}`, h("span", {}, `${time.toFixed(1)} s`)),
    );
    this.root.dataset.fitSteps = steps;
  }

  updateStatus() {
    const { statusFields: fields, view } = this;
    const subject = this.subject();
    const header = this.pictures.a?.header;
    fields.coverage.textContent = subject?.is_image ? "image" : coverageText(this.settings);
    fields.size.textContent = view ? `${view.width} × ${view.height} px` : "";
    fields.zoom.textContent = view ? percentText(view.zoom) : "";
    fields.position.textContent = view ? `at ${view.x}, ${view.y}` : "";
    const error = this.isClosed ? "The viewer has ended." : subject?.error || this.error;
    fields.notes.textContent = error || header?.notes?.[0] || "";
    fields.notes.className = error ? "sr-wrong" : "sr-optional";
    this.updateTime(header);
    this.updateTilesNote();
  }

  // Shows how long the last picture took, or that a picture is taking long.
  updateTime(header) {
    const { time } = this.statusFields;
    const { state } = this.root.dataset;
    const isBusy = state === "pending" && performance.now() - this.requestedAt > BUSY_MS;
    time.className = isBusy ? "sr-busy" : "";
    if (isBusy) {
      time.textContent = header ? "drawing" : "compiling";
    } else if (header && state === "exact") {
      const { milliseconds, compile_seconds: compileSeconds } = header;
      const total = milliseconds >= 1000
        ? `${(milliseconds / 1000).toFixed(1)} s`
        : `${milliseconds.toFixed(0)} ms`;
      const compilation = compileSeconds > 0
        ? `, of which ${compileSeconds.toFixed(1)} s compiling`
        : "";
      time.textContent = this.subject()?.is_image ? "" : `${total}${compilation}`;
    }
  }

  updateTilesNote() {
    const tiles = this.overlayData.tiles?.header;
    if (!tiles) return;
    const [pairs, capacity] = [tiles.pairs_listed, tiles.pairs_capacity];
    this.tilesNote.textContent =
      `${tiles.columns} × ${tiles.rows} tiles of ${tiles.tile_width} × ${tiles.tile_height} px; ` +
      `${tiles.mean.toFixed(1)} triangles each, ${tiles.max} at most. ` +
      `${pairs.toLocaleString("en")} pairs; the plan holds ${capacity.toLocaleString("en")}.`;
    this.tilesNote.hidden = !this.overlays.tiles;
  }

  // Shows a message for a few seconds.
  say(message) {
    this.toast.textContent = message;
    this.toast.hidden = false;
    clearTimeout(this.toastTimer);
    this.toastTimer = setTimeout(() => (this.toast.hidden = true), 6000);
  }
}

export function mount(root, transport, options) {
  return new Viewer(root, transport, options);
}

// ---- The notebook widget ----

// Hides the picture that a notebook shows above the widget for pages without a kernel.
function hideStillPicture(element, still) {
  const outputs = element.closest(".jp-OutputArea, .output, .cell-output") ?? element.parentElement;
  for (const image of outputs?.querySelectorAll("img") ?? []) {
    // Notebooks may break the data of a picture into lines.
    const source = image.src.replace(/\s|%0A/g, "");
    if (image.closest(".sr-viewer") || source !== still) continue;
    (image.closest(".jp-OutputArea-child, .output_area") ?? image).style.display = "none";
  }
}

// anywidget calls `render` once for each output that shows the widget.
export default {
  render({ model, el }) {
    const root = document.createElement("div");
    root.style.height = `${model.get("height")}px`;
    el.append(root);
    const still = model.get("still");
    const viewer = mount(root, openModel(model), { isWidget: true, still });
    // `el` may not be part of the page yet.
    requestAnimationFrame(() => hideStillPicture(el, still));
    return () => viewer.close();
  },
};

// ---- The page of `softras2d view` ----

const page = document.querySelector("[data-softras2d-page]");
if (page) {
  const address = new URL("socket", location.href);
  address.protocol = "ws:";
  mount(page, openSocket(address));
}
