// The operations of kernel/kernels.wat in plain JavaScript, for browsers without WebAssembly SIMD.
// Addresses are in bytes, lengths in numbers; every operation adds to y.
function plainKernels(buffer) {
  const F = new Float32Array(buffer), I = new Int32Array(buffer);

  function dot(p, q, n) {
    let sum = 0;
    for (let i = 0; i < n; i++) sum += F[p + i] * F[q + i];
    return sum;
  }

  function axpy(y, v, n, s) {
    for (let i = 0; i < n; i++) F[y + i] += F[v + i] * s;
  }

  return {
    count_lit(n, planes, x, counts) {
      x >>= 2; counts >>= 2;
      let found = 0;
      I[counts] = 0;
      for (let i = 0; i < n; i++) {
        for (let plane = 0; plane < planes; plane++) {
          if (F[x + plane * n + i] !== 0) { found++; break; }
        }
        I[counts + i + 1] = found;
      }
    },
    leaves(n, table, values, x, y, counts) {
      table >>= 2; values >>= 2; x >>= 2; y >>= 2; counts >>= 2;
      for (const end = table + 4 * n; table < end; table += 4) {
        const a = I[table], na = I[table + 1], b = I[table + 2], nb = I[table + 3];
        const vb = values + na;
        const to = nb ? [y + b, vb, nb] : [y + a, values, na];
        if (I[counts + a] !== I[counts + a + na]) axpy(...to, dot(values, x + a, na));
        if (nb && I[counts + b] !== I[counts + b + nb]) axpy(y + a, values, na, dot(vb, x + b, nb));
        values = vb + nb;
      }
    },
    pairs(n, first, second, values, x, y) {
      first >>= 2; second >>= 2; values >>= 2; x >>= 2; y >>= 2;
      for (let i = 0; i < n; i++) {
        const a = I[first + i], b = I[second + i], v = F[values + i];
        F[y + a] += v * F[x + b];
        if (a !== b) F[y + b] += v * F[x + a];
      }
    },
    csr(rows, counts, columns, values, x, y) {
      counts >>= 2; columns >>= 2; values >>= 2; x >>= 2; y >>= 2;
      for (let row = 0; row < rows; row++) {
        let sum = 0;
        for (let k = I[counts + row]; k > 0; k--) sum += F[values++] * F[x + I[columns++]];
        F[y + row] += sum;
      }
    },
    csr_transposed(rows, counts, columns, values, x, y) {
      counts >>= 2; columns >>= 2; values >>= 2; x >>= 2; y >>= 2;
      for (let row = 0; row < rows; row++) {
        const light = F[x + row];
        for (let k = I[counts + row]; k > 0; k--) F[y + I[columns++]] += F[values++] * light;
      }
    },
    dense(rows, columns, values, x, y) {
      values >>= 2; x >>= 2; y >>= 2;
      for (let row = 0; row < rows; row++) F[y + row] += dot(values + row * columns, x, columns);
    },
    dense_transposed(rows, columns, values, x, y) {
      values >>= 2; x >>= 2; y >>= 2;
      for (let row = 0; row < rows; row++) {
        if (F[x + row] !== 0) axpy(y, values + row * columns, columns, F[x + row]);
      }
    },
    scale(n, values, x, y) {
      values >>= 2; x >>= 2; y >>= 2;
      for (let i = 0; i < n; i++) F[y + i] += F[values + i] * F[x + i];
    },
    gather(n, index, x, y) {
      index >>= 2; x >>= 2; y >>= 2;
      for (let i = 0; i < n; i++) F[y + i] += F[x + I[index + i]];
    },
    gather_transposed(n, index, x, y) {
      index >>= 2; x >>= 2; y >>= 2;
      for (let i = 0; i < n; i++) F[y + I[index + i]] += F[x + i];
    },
  };
}
