/** What a body's environment does around the physics: how episodes begin, what is observed, what is controlled, when they end. */

import { readExpression } from "./expression.js";

export class Task {
  /** @param {object} recipe `simulation.json`. @param {object} data MuJoCo's. */
  constructor(recipe, data) {
    this.recipe = recipe;
    this.data = data;
    this.parts = Object.fromEntries(["begin", "control", "step"].map((name) => [name, readExpression(recipe[name])]));
    this.kept = [...new Set(Object.values(this.parts).flatMap(({ inputs }) => inputs))].filter((name) => name.startsWith("before."));
    this.before = {};
    this.carried = {};
    this.layout = null;
  }

  /** From the next start on, the ground is this one of `recipe.terrain.layouts`. */
  setLayout(layout) {
    this.layout = layout;
  }

  /** Put the body where an episode begins. random: a number in [0, 1). */
  place(random) {
    const { starts, terrain } = this.recipe;
    const start = starts[Math.floor(random() * starts.length)];
    for (const [name, values] of Object.entries(start)) if (values.length) this.data[name].set(values);
    if (this.layout) this.data.qpos[terrain.root_height] += this.layout.lift;
  }

  /** @returns {number[]} The observation at an episode's start. */
  begin(command) {
    return this.#observed("begin", { command });
  }

  /** @returns {number[]} The controls under an action. */
  control(action, command) {
    for (const name of this.kept) this.before[name] = Float64Array.from(this.#field(name));
    return this.parts.control.evaluate(this.#reader({ action, command })).control;
  }

  /** After the physics of a step. @returns {{observation: number[], ended: boolean}} */
  after(action, command) {
    return this.#observed("step", { action, command });
  }

  #observed(part, given) {
    const { observation, ended = [0], ...carried } = this.parts[part].evaluate(this.#reader(given));
    this.carried = carried;
    return part === "begin" ? observation : { observation, ended: ended[0] !== 0 };
  }

  #reader = (given) => (name) => given[name] ?? this.carried[name] ?? this.before[name] ?? this.layout?.[name] ?? this.#field(name);

  /** Of MuJoCo's data; `time` is one number. */
  #field(name) {
    const values = this.data[name.slice(name.indexOf(".") + 1)];
    return typeof values === "number" ? [values] : values;
  }
}
