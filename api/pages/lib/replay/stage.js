/** What is seen: figures, light, sky and camera on a canvas. It draws only when something changed. */

import {
  AmbientLight,
  CanvasTexture,
  ColorManagement,
  Color,
  DirectionalLight,
  Fog,
  Group,
  LinearSRGBColorSpace,
  PCFShadowMap,
  PerspectiveCamera,
  Scene,
  Vector3,
  WebGLRenderer,
} from "../../vendor/three.js";
import { OrbitControls } from "../../vendor/three-orbit-controls.js";
import { Figure } from "./figure.js";

ColorManagement.enabled = false;

// Slower than this, on average, a stage that plays gives up shadows and then pixels.
const SLOW_MS = 40;
const PATIENCE_MS = 1500;
const PIXELS = [2, 1, 0.75, 0.5]; // of the canvas for one of the page, by quality

/** MuJoCo's axes (z up) as those of three.js (y up). */
const turned = ([x, y, z], into = new Vector3()) => into.set(x, z, -y);

export class Stage {
  /** @param {() => void} onChange Called after each picture. Raises Error where there is no WebGL. */
  constructor(canvas, onChange) {
    // Without a GPU every pixel costs: no smooth edges, no shadows.
    this.quality = isSoftware() ? 1 : 0;
    this.renderer = new WebGLRenderer({ canvas, antialias: this.quality === 0 });
    this.renderer.outputColorSpace = LinearSRGBColorSpace;
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = PCFShadowMap;
    this.onChange = onChange;
    this.scene = new Scene();
    this.camera = new PerspectiveCamera(45, 1, 0.01, 1000);
    this.scene.add(this.camera);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.addEventListener("change", () => this.draw());
    this.#addLights();
    this.group = new Group();
    this.scene.add(this.group);
    this.figures = [];
    this.time = 0;
    // shadows: null where the machine decides.
    this.options = { follow: true, contacts: false, shadows: null, ghost: true };
    this.slow = { ms: 0, frames: 0 };
    this.observer = new ResizeObserver(() => this.#resize());
    this.observer.observe(canvas.parentElement);
    this.#resize();
  }

  /**
   * Show these episodes. isBeside: next to each other; otherwise where they were, over each other.
   * The camera stays where it is if the stage has shown as many of this scene before.
   */
  setEpisodes(scene, about, episodes, isBeside) {
    const layout = `${episodes.length} ${isBeside}`;
    const isNew = scene !== this.shown;
    const isOtherwise = isNew || layout !== this.layout;
    this.#clear();
    this.shown = scene;
    this.layout = layout;
    this.about = about;
    this.figures = episodes.map((episode, number) => new Figure(scene, about, episode, number === 0));
    const apart = isBeside ? spacing(about, episodes) : 0;
    this.width = apart * (episodes.length - 1);
    this.figures.forEach((figure, number) => {
      figure.root.position.z = apart * (number - (episodes.length - 1) / 2);
      this.group.add(figure.root);
    });
    if (isNew) this.#setScene(about);
    if (isOtherwise) this.resetView();
    this.target.copy(this.#lookAt());
    this.show(this.time);
  }

  get duration() {
    return Math.max(0, ...this.figures.map((figure) => figure.motion.duration));
  }

  /** Show a moment. */
  show(time) {
    this.time = time;
    for (const figure of this.figures) figure.show(time, this.options);
    const target = this.#lookAt();
    if (this.options.follow) {
      const moved = target.clone().sub(this.target);
      this.camera.position.add(moved);
      this.controls.target.add(moved);
    }
    this.target.copy(target);
    this.draw();
  }

  setOptions(options) {
    Object.assign(this.options, options);
    if (this.figures.length) this.show(this.time);
  }

  /** Look as the videos' camera `track` does. */
  resetView() {
    const { azimuth, elevation, distance } = this.about.view;
    const [across, up] = [azimuth, elevation].map((degrees) => (degrees * Math.PI) / 180);
    const forward = [Math.cos(up) * Math.cos(across), Math.cos(up) * Math.sin(across), Math.sin(up)];
    this.target = this.#lookAt();
    this.controls.target.copy(this.target);
    this.camera.position.copy(this.target).addScaledVector(turned(forward), -distance - this.width);
    this.controls.update();
    this.draw();
  }

  /** Come closer by a factor, or go away. */
  zoom(factor) {
    this.camera.position.sub(this.controls.target).multiplyScalar(factor).add(this.controls.target);
    this.controls.update();
    this.draw();
  }

  /** Turn about the body, by degrees. */
  orbit(degrees) {
    const from = this.camera.position.clone().sub(this.controls.target);
    from.applyAxisAngle(new Vector3(0, 1, 0), (degrees * Math.PI) / 180);
    this.camera.position.copy(this.controls.target).add(from);
    this.controls.update();
    this.draw();
  }

  /** Draw once, before the browser's next picture. */
  draw() {
    this.request ||= requestAnimationFrame(() => {
      this.request = 0;
      this.drawNow();
    });
  }

  drawNow() {
    if (!this.figures.length) return;
    const { x, y, z } = this.controls.target;
    for (const figure of this.figures) figure.recentre([x, -z]);
    this.sun.castShadow = this.options.shadows ?? this.quality === 0;
    this.sun.target.position.copy(this.target);
    this.sun.position.copy(this.target).addScaledVector(this.sunDirection, -12 * this.about.view.radius);
    this.renderer.render(this.scene, this.camera);
    this.onChange();
  }

  /** Tell how long the last pictures took, while they play: a slow machine gets simpler ones. ms: since the last. */
  pace(ms) {
    this.slow.ms += ms;
    this.slow.frames += 1;
    if (this.slow.ms < PATIENCE_MS) return;
    const mean = this.slow.ms / this.slow.frames;
    this.slow = { ms: 0, frames: 0 };
    if (mean > SLOW_MS && this.quality < 3) {
      this.quality += 1;
      this.#resize();
    }
  }

  dispose() {
    this.observer.disconnect();
    cancelAnimationFrame(this.request);
    this.#clear();
    this.controls.dispose();
    this.scene.background?.dispose?.();
    this.renderer.dispose();
    this.renderer.forceContextLoss(); // Browsers keep few contexts, and free them late.
  }

  #addLights() {
    this.ambient = new AmbientLight(0xffffff, 0.42 * Math.PI);
    this.head = new DirectionalLight(0xffffff, 0.35 * Math.PI);
    this.camera.add(this.head, this.head.target);
    this.head.position.set(0, 0, 1);
    this.sun = new DirectionalLight(0xffffff, 1);
    this.sun.shadow.mapSize.set(1024, 1024);
    this.sun.shadow.bias = -0.0005;
    this.scene.add(this.ambient, this.sun, this.sun.target);
  }

  #setScene({ view, sun, sky }) {
    const { radius } = view;
    this.target = new Vector3();
    this.sunDirection = turned(sun.direction).normalize();
    this.sun.color.setRGB(...sun.diffuse);
    this.sun.intensity = 0.9 * Math.PI;
    this.sun.shadow.normalBias = 0.02 * radius;
    const shadow = this.sun.shadow.camera;
    Object.assign(shadow, { left: -4 * radius, right: 4 * radius, top: 4 * radius, bottom: -4 * radius, near: radius, far: 24 * radius });
    shadow.updateProjectionMatrix();
    Object.assign(this.camera, { fov: view.fovy, near: 0.05 * radius, far: 400 * radius });
    this.controls.minDistance = 0.3 * radius;
    this.controls.maxDistance = 60 * radius;
    this.scene.background = gradient(...sky);
    this.scene.fog = new Fog(new Color(...sky[1]), 40 * radius, 200 * radius);
    this.#resize();
  }

  #lookAt() {
    const sum = new Vector3();
    for (const figure of this.figures) sum.add(turned(figure.lookAt(this.time))).add(figure.root.position);
    return sum.divideScalar(this.figures.length || 1);
  }

  #resize() {
    const { clientWidth: width, clientHeight: height } = this.renderer.domElement.parentElement;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(PIXELS[this.quality], devicePixelRatio));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.drawNow();
  }

  #clear() {
    for (const figure of this.figures) {
      this.group.remove(figure.root);
      figure.dispose();
    }
    this.figures = [];
  }
}

/** Metres between episodes that stand next to each other: more than their own surroundings take, if they differ. */
function spacing(about, episodes) {
  const widths = episodes.flatMap(({ parts }) => parts.map(({ translation, scale }) => Math.abs(translation[1]) + scale[1]));
  return Math.max(2.2 * about.view.radius, ...widths.map((width) => 2.1 * width));
}

/** Whether WebGL is computed without a GPU. */
function isSoftware() {
  const gl = document.createElement("canvas").getContext("webgl2");
  const names = gl?.getExtension("WEBGL_debug_renderer_info");
  const found = /swiftshader|llvmpipe|softpipe/i.test(names ? gl.getParameter(names.UNMASKED_RENDERER_WEBGL) : "");
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return found;
}

function gradient(zenith, horizon) {
  const canvas = document.createElement("canvas");
  canvas.width = 2;
  canvas.height = 256;
  const context = canvas.getContext("2d");
  const fill = context.createLinearGradient(0, 0, 0, 256);
  const css = (colour) => `rgb(${colour.map((part) => Math.round(255 * part)).join(" ")})`;
  fill.addColorStop(0, css(zenith));
  fill.addColorStop(0.75, css(horizon));
  context.fillStyle = fill;
  context.fillRect(0, 0, 2, 256);
  return new CanvasTexture(canvas);
}
