/** What an environment computes around its physics, as `simulation.json` has it (docs/push.md): plain operations on numbers. */

const truth = (is) => (is ? 1 : 0);
const OPERATIONS = {
  abs: Math.abs,
  acos: Math.acos,
  add: (a, b) => a + b,
  and: (a, b) => truth(a && b),
  asin: Math.asin,
  atan2: Math.atan2,
  ceil: Math.ceil,
  cos: Math.cos,
  div: (a, b) => a / b,
  eq: (a, b) => truth(a === b),
  exp: Math.exp,
  floor: Math.floor,
  ge: (a, b) => truth(a >= b),
  gt: (a, b) => truth(a > b),
  is_finite: (a) => truth(Number.isFinite(a)),
  le: (a, b) => truth(a <= b),
  log: Math.log,
  lt: (a, b) => truth(a < b),
  max: Math.max,
  min: Math.min,
  mul: (a, b) => a * b,
  ne: (a, b) => truth(a !== b),
  neg: (a) => -a,
  or: (a, b) => truth(a || b),
  pow: Math.pow,
  rem: (a, b) => a % b,
  select: (condition, otherwise, chosen) => (condition ? chosen : otherwise),
  sign: Math.sign,
  sin: Math.sin,
  sqrt: Math.sqrt,
  sub: (a, b) => a - b,
  tan: Math.tan,
  tanh: Math.tanh,
  trunc: Math.trunc,
};
const REDUCTIONS = {
  reduce_max: Math.max,
  reduce_min: Math.min,
  reduce_prod: (a, b) => a * b,
  reduce_sum: (a, b) => a + b,
};

// JSON has no number for these; of others, such as "nan", Number makes NaN.
const INFINITE = { inf: Infinity, "-inf": -Infinity };

/** @param {object} text The document. Raises Error for an operation that the page lacks. */
export function readExpression({ inputs, constants, operations, outputs }) {
  for (const [name] of operations) if (!OPERATIONS[name] && !REDUCTIONS[name]) throw new Error(`The page has no operation ${name}.`);
  const known = inputs.reduce((sum, [, places]) => sum + places.length, 0);
  const size = operations.reduce((sum, [, results]) => sum + results, known + constants.length);
  const cells = new Float64Array(size);
  cells.set(constants.map((one) => INFINITE[one] ?? Number(one)), known);

  /** @param {(name: string) => ArrayLike<number>} read The input. Returns the outputs by name. */
  const evaluate = (read) => {
    let next = 0;
    for (const [name, places] of inputs) {
      const values = read(name);
      for (const place of places) cells[next++] = values[place];
    }
    next += constants.length;
    for (const [name, results, first, second, third] of operations) {
      const reduce = REDUCTIONS[name];
      const act = OPERATIONS[name];
      const each = first.length / results;
      for (let i = 0; i < results; i++) {
        if (reduce) {
          let value = cells[first[i * each]];
          for (let k = 1; k < each; k++) value = reduce(value, cells[first[i * each + k]]);
          cells[next++] = value;
        } else if (third) cells[next++] = act(cells[first[i]], cells[second[i]], cells[third[i]]);
        else if (second) cells[next++] = act(cells[first[i]], cells[second[i]]);
        else cells[next++] = act(cells[first[i]]);
      }
    }
    return Object.fromEntries(Object.entries(outputs).map(([name, places]) => [name, places.map((place) => cells[place])]));
  };
  return { evaluate, inputs: inputs.map(([name]) => name) };
}
