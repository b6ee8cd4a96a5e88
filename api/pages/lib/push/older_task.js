/** The same as a `Task`, for simulations of version 1, which say where the observation's numbers are in MuJoCo's arrays. */

const NUM_AHEAD = 10; // obstacles of a corridor

export class OlderTask {
  constructor(recipe, data, model) {
    Object.assign(this, { recipe, data, model });
    this.mass = model.body_mass.reduce((sum, mass) => sum + mass, 0);
  }

  place(random) {
    const { qpos, qvel = [], act = [], noise } = this.recipe;
    const even = (scale) => scale * (2 * random() - 1);
    const normal = (scale) => scale * Math.sqrt(-2 * Math.log(1 - random())) * Math.cos(2 * Math.PI * random());
    const jolt = () => (noise.is_normal ? normal(noise.velocity) : even(noise.velocity));
    this.data.qpos.set(qpos.map((value) => value + even(noise.position)));
    this.data.qvel.set(Array.from(this.data.qvel, (_, place) => (qvel[place] ?? 0) + jolt()));
    if (act.length) this.data.act.set(act);
  }

  begin() {
    this.action = new Float64Array(this.model.nu);
    return this.#observe();
  }

  control(action) {
    const { control_offset: offset, control_gain: gain } = this.recipe;
    this.action = action;
    return [...action].map((value, i) => offset[i] + gain[i] * value);
  }

  after() {
    const isOutside = ({ numbers, low, high }) =>
      this.#read(numbers).some((value) => value < (low ?? -Infinity) || value > (high ?? Infinity) || Number.isNaN(value));
    return { observation: this.#observe(), ended: this.recipe.ends.some(isOutside) };
  }

  #observe() {
    return this.recipe.observation.flatMap((numbers) => this.#read(numbers));
  }

  #read({ array, places, less, add, max_abs: most }) {
    const values = this.#array(array);
    return places.map((place, i) => {
      const value = values[place] + add - (less.length ? values[less[i]] : 0);
      return most === null ? value : Math.min(Math.max(value, -most), most);
    });
  }

  #array(name) {
    if (name === "previous_action") return this.action;
    if (name === "obstacles_ahead") return this.#ahead();
    if (name === "share_velocity") return this.#shares();
    return this.data[name];
  }

  /** Of each next obstacle, how far ahead it begins and ends and how far to the left the way past it is. */
  #ahead() {
    const { obstacles, sight } = this.recipe;
    const [x, y] = this.data.qpos;
    const coming = obstacles.filter(([, end]) => end >= x).slice(0, NUM_AHEAD);
    const seen = coming.map(([begin, end, middle]) => [Math.min(begin - x, sight), Math.min(end - x, sight), begin - x < sight ? middle - y : 0]);
    while (seen.length < NUM_AHEAD) seen.push([sight, sight, 0]);
    return seen.flat();
  }

  #shares() {
    const { cinert, cvel } = this.data;
    const shares = [];
    for (let body = 0; body < this.model.nbody; body++) {
      const [ax, ay, az, vx, vy, vz] = cvel.subarray(6 * body, 6 * body + 6);
      const [mx, my, mz, mass] = cinert.subarray(10 * body + 6, 10 * body + 10);
      // The velocity at the body's own centre of mass, by its share of all masses: m v + ω × m c.
      const own = [mass * vx + ay * mz - az * my, mass * vy + az * mx - ax * mz, mass * vz + ax * my - ay * mx];
      shares.push(...own.map((part) => part / this.mass), ax, ay, az);
    }
    return shares;
  }
}
