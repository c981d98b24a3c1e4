;; The operations of rfpipe.viewer.program between vectors of float32, with SIMD.
;;
;; Addresses are in bytes, lengths in numbers. Every operation adds to y. `kernels.wasm` beside this
;; file is made from it by `python -m rfpipe.viewer.kernel`; web/kernels.js does the same without
;; SIMD.
(module
  (import "env" "memory" (memory 1))

  ;; sum of p[i] q[i]
  (func $dot (param $p i32) (param $q i32) (param $n i32) (result f32)
    (local $end i32) (local $s v128) (local $t v128) (local $sum f32)
    (local.set $end (i32.add (local.get $p) (i32.and (i32.shl (local.get $n) (i32.const 2)) (i32.const -32))))
    (if (i32.lt_u (local.get $p) (local.get $end)) (then
      (loop $by8
        (local.set $s (f32x4.add (local.get $s)
          (f32x4.mul (v128.load (local.get $p)) (v128.load (local.get $q)))))
        (local.set $t (f32x4.add (local.get $t)
          (f32x4.mul (v128.load offset=16 (local.get $p)) (v128.load offset=16 (local.get $q)))))
        (local.set $p (i32.add (local.get $p) (i32.const 32)))
        (local.set $q (i32.add (local.get $q) (i32.const 32)))
        (br_if $by8 (i32.lt_u (local.get $p) (local.get $end))))
      (local.set $s (f32x4.add (local.get $s) (local.get $t)))
      (local.set $sum (f32.add
        (f32.add (f32x4.extract_lane 0 (local.get $s)) (f32x4.extract_lane 1 (local.get $s)))
        (f32.add (f32x4.extract_lane 2 (local.get $s)) (f32x4.extract_lane 3 (local.get $s)))))))
    (local.set $end (i32.add (local.get $p) (i32.shl (i32.and (local.get $n) (i32.const 7)) (i32.const 2))))
    (if (i32.lt_u (local.get $p) (local.get $end)) (then
      (loop $by1
        (local.set $sum (f32.add (local.get $sum)
          (f32.mul (f32.load (local.get $p)) (f32.load (local.get $q)))))
        (local.set $p (i32.add (local.get $p) (i32.const 4)))
        (local.set $q (i32.add (local.get $q) (i32.const 4)))
        (br_if $by1 (i32.lt_u (local.get $p) (local.get $end))))))
    (local.get $sum))

  ;; sum of p[i] q[i] in float64, for terms that cancel
  (func $dot64 (param $p i32) (param $q i32) (param $n i32) (result f32)
    (local $end i32) (local $s v128) (local $sum f64)
    (local.set $end (i32.add (local.get $p) (i32.and (i32.shl (local.get $n) (i32.const 2)) (i32.const -8))))
    (if (i32.lt_u (local.get $p) (local.get $end)) (then
      (loop $by2
        (local.set $s (f64x2.add (local.get $s) (f64x2.mul
          (f64x2.promote_low_f32x4 (v128.load64_zero (local.get $p)))
          (f64x2.promote_low_f32x4 (v128.load64_zero (local.get $q))))))
        (local.set $p (i32.add (local.get $p) (i32.const 8)))
        (local.set $q (i32.add (local.get $q) (i32.const 8)))
        (br_if $by2 (i32.lt_u (local.get $p) (local.get $end))))))
    (local.set $sum (f64.add (f64x2.extract_lane 0 (local.get $s)) (f64x2.extract_lane 1 (local.get $s))))
    (if (i32.and (local.get $n) (i32.const 1)) (then
      (local.set $sum (f64.add (local.get $sum) (f64.mul
        (f64.promote_f32 (f32.load (local.get $p))) (f64.promote_f32 (f32.load (local.get $q))))))))
    (f32.demote_f64 (local.get $sum)))

  ;; y[i] += v[i] s
  (func $axpy (param $y i32) (param $v i32) (param $n i32) (param $s f32)
    (local $end i32) (local $splat v128)
    (local.set $splat (f32x4.splat (local.get $s)))
    (local.set $end (i32.add (local.get $y) (i32.and (i32.shl (local.get $n) (i32.const 2)) (i32.const -16))))
    (if (i32.lt_u (local.get $y) (local.get $end)) (then
      (loop $by4
        (v128.store (local.get $y) (f32x4.add (v128.load (local.get $y))
          (f32x4.mul (v128.load (local.get $v)) (local.get $splat))))
        (local.set $y (i32.add (local.get $y) (i32.const 16)))
        (local.set $v (i32.add (local.get $v) (i32.const 16)))
        (br_if $by4 (i32.lt_u (local.get $y) (local.get $end))))))
    (local.set $end (i32.add (local.get $y) (i32.shl (i32.and (local.get $n) (i32.const 3)) (i32.const 2))))
    (if (i32.lt_u (local.get $y) (local.get $end)) (then
      (loop $by1
        (f32.store (local.get $y) (f32.add (f32.load (local.get $y))
          (f32.mul (f32.load (local.get $v)) (local.get $s))))
        (local.set $y (i32.add (local.get $y) (i32.const 4)))
        (local.set $v (i32.add (local.get $v) (i32.const 4)))
        (br_if $by1 (i32.lt_u (local.get $y) (local.get $end)))))))

  ;; whether x[at] ... x[at + n - 1] has light, by the counts of lit numbers before each
  (func $lit (param $counts i32) (param $at i32) (param $n i32) (result i32)
    (local.set $counts (i32.add (local.get $counts) (i32.shl (local.get $at) (i32.const 2))))
    (i32.ne (i32.load (local.get $counts))
      (i32.load (i32.add (local.get $counts) (i32.shl (local.get $n) (i32.const 2))))))

  ;; counts[i] = how many of x[0] ... x[i - 1] aren't 0 in some of the planes; n + 1 of them
  (func (export "count_lit") (param $n i32) (param $planes i32) (param $x i32) (param $counts i32)
    (local $i i32) (local $plane i32) (local $found i32) (local $at i32) (local $stride i32)
    (local.set $stride (i32.shl (local.get $n) (i32.const 2)))
    (i32.store (local.get $counts) (i32.const 0))
    (block $done (loop $next
      (br_if $done (i32.ge_u (local.get $i) (local.get $n)))
      (local.set $plane (local.get $planes))
      (local.set $at (i32.add (local.get $x) (i32.shl (local.get $i) (i32.const 2))))
      (block $settled (loop $planewise
        (if (f32.ne (f32.load (local.get $at)) (f32.const 0)) (then
          (local.set $found (i32.add (local.get $found) (i32.const 1)))
          (br $settled)))
        (local.set $at (i32.add (local.get $at) (local.get $stride)))
        (local.set $plane (i32.sub (local.get $plane) (i32.const 1)))
        (br_if $planewise (local.get $plane))))
      (local.set $counts (i32.add (local.get $counts) (i32.const 4)))
      (i32.store (local.get $counts) (local.get $found))
      (local.set $i (i32.add (local.get $i) (i32.const 1)))
      (br $next))))

  ;; leaves of rank 1: for each, in `table`, where its two runs begin and how long they are (the
  ;; second of length 0 where both are the same); its factors' values
  (func (export "leaves") (param $n i32) (param $table i32) (param $values i32)
      (param $x i32) (param $y i32) (param $counts i32)
    (local $end i32) (local $a i32) (local $na i32) (local $b i32) (local $nb i32) (local $vb i32)
    (local.set $end (i32.add (local.get $table) (i32.shl (local.get $n) (i32.const 4))))
    (block $done (loop $next
      (br_if $done (i32.ge_u (local.get $table) (local.get $end)))
      (local.set $a (i32.load (local.get $table)))
      (local.set $na (i32.load offset=4 (local.get $table)))
      (local.set $b (i32.load offset=8 (local.get $table)))
      (local.set $nb (i32.load offset=12 (local.get $table)))
      (local.set $vb (i32.add (local.get $values) (i32.shl (local.get $na) (i32.const 2))))
      (if (call $lit (local.get $counts) (local.get $a) (local.get $na)) (then
        (if (local.get $nb)
          (then (call $axpy
            (i32.add (local.get $y) (i32.shl (local.get $b) (i32.const 2)))
            (local.get $vb) (local.get $nb)
            (call $dot (local.get $values)
              (i32.add (local.get $x) (i32.shl (local.get $a) (i32.const 2))) (local.get $na))))
          (else (call $axpy
            (i32.add (local.get $y) (i32.shl (local.get $a) (i32.const 2)))
            (local.get $values) (local.get $na)
            (call $dot (local.get $values)
              (i32.add (local.get $x) (i32.shl (local.get $a) (i32.const 2))) (local.get $na)))))))
      (if (local.get $nb) (then
        (if (call $lit (local.get $counts) (local.get $b) (local.get $nb)) (then
          (call $axpy
            (i32.add (local.get $y) (i32.shl (local.get $a) (i32.const 2)))
            (local.get $values) (local.get $na)
            (call $dot (local.get $vb)
              (i32.add (local.get $x) (i32.shl (local.get $b) (i32.const 2))) (local.get $nb)))))))
      (local.set $values (i32.add (local.get $vb) (i32.shl (local.get $nb) (i32.const 2))))
      (local.set $table (i32.add (local.get $table) (i32.const 16)))
      (br $next))))

  ;; y[a] += v x[b], and y[b] += v x[a] unless a = b
  (func (export "pairs") (param $n i32) (param $first i32) (param $second i32) (param $values i32)
      (param $x i32) (param $y i32)
    (local $end i32) (local $a i32) (local $b i32) (local $at i32) (local $v f32)
    (local.set $end (i32.add (local.get $first) (i32.shl (local.get $n) (i32.const 2))))
    (block $done (loop $next
      (br_if $done (i32.ge_u (local.get $first) (local.get $end)))
      (local.set $a (i32.shl (i32.load (local.get $first)) (i32.const 2)))
      (local.set $b (i32.shl (i32.load (local.get $second)) (i32.const 2)))
      (local.set $v (f32.load (local.get $values)))
      (local.set $at (i32.add (local.get $y) (local.get $a)))
      (f32.store (local.get $at) (f32.add (f32.load (local.get $at))
        (f32.mul (local.get $v) (f32.load (i32.add (local.get $x) (local.get $b))))))
      (if (i32.ne (local.get $a) (local.get $b)) (then
        (local.set $at (i32.add (local.get $y) (local.get $b)))
        (f32.store (local.get $at) (f32.add (f32.load (local.get $at))
          (f32.mul (local.get $v) (f32.load (i32.add (local.get $x) (local.get $a))))))))
      (local.set $first (i32.add (local.get $first) (i32.const 4)))
      (local.set $second (i32.add (local.get $second) (i32.const 4)))
      (local.set $values (i32.add (local.get $values) (i32.const 4)))
      (br $next))))

  ;; a sparse matrix row by row: counts[r] entries, each a column and a value
  (func (export "csr") (param $rows i32) (param $counts i32) (param $columns i32)
      (param $values i32) (param $x i32) (param $y i32)
    (local $stop i32) (local $end i32) (local $sum f32)
    (local.set $stop (i32.add (local.get $counts) (i32.shl (local.get $rows) (i32.const 2))))
    (block $done (loop $row
      (br_if $done (i32.ge_u (local.get $counts) (local.get $stop)))
      (local.set $end (i32.add (local.get $columns) (i32.shl (i32.load (local.get $counts)) (i32.const 2))))
      (local.set $sum (f32.load (local.get $y)))
      (block $summed (loop $entry
        (br_if $summed (i32.ge_u (local.get $columns) (local.get $end)))
        (local.set $sum (f32.add (local.get $sum) (f32.mul (f32.load (local.get $values))
          (f32.load (i32.add (local.get $x) (i32.shl (i32.load (local.get $columns)) (i32.const 2)))))))
        (local.set $columns (i32.add (local.get $columns) (i32.const 4)))
        (local.set $values (i32.add (local.get $values) (i32.const 4)))
        (br $entry)))
      (f32.store (local.get $y) (local.get $sum))
      (local.set $y (i32.add (local.get $y) (i32.const 4)))
      (local.set $counts (i32.add (local.get $counts) (i32.const 4)))
      (br $row))))

  ;; the same, transposed: dark rays are skipped
  (func (export "csr_transposed") (param $rows i32) (param $counts i32) (param $columns i32)
      (param $values i32) (param $x i32) (param $y i32)
    (local $stop i32) (local $end i32) (local $at i32) (local $light f32) (local $bytes i32)
    (local.set $stop (i32.add (local.get $counts) (i32.shl (local.get $rows) (i32.const 2))))
    (block $done (loop $row
      (br_if $done (i32.ge_u (local.get $counts) (local.get $stop)))
      (local.set $bytes (i32.shl (i32.load (local.get $counts)) (i32.const 2)))
      (local.set $end (i32.add (local.get $columns) (local.get $bytes)))
      (local.set $light (f32.load (local.get $x)))
      (if (f32.ne (local.get $light) (f32.const 0))
        (then (block $spread (loop $entry
          (br_if $spread (i32.ge_u (local.get $columns) (local.get $end)))
          (local.set $at (i32.add (local.get $y) (i32.shl (i32.load (local.get $columns)) (i32.const 2))))
          (f32.store (local.get $at) (f32.add (f32.load (local.get $at))
            (f32.mul (f32.load (local.get $values)) (local.get $light))))
          (local.set $columns (i32.add (local.get $columns) (i32.const 4)))
          (local.set $values (i32.add (local.get $values) (i32.const 4)))
          (br $entry))))
        (else
          (local.set $columns (local.get $end))
          (local.set $values (i32.add (local.get $values) (local.get $bytes)))))
      (local.set $x (i32.add (local.get $x) (i32.const 4)))
      (local.set $counts (i32.add (local.get $counts) (i32.const 4)))
      (br $row))))

  (func (export "dense") (param $rows i32) (param $columns i32) (param $values i32) (param $x i32)
      (param $y i32)
    (local $end i32)
    (local.set $end (i32.add (local.get $y) (i32.shl (local.get $rows) (i32.const 2))))
    (block $done (loop $row
      (br_if $done (i32.ge_u (local.get $y) (local.get $end)))
      (f32.store (local.get $y) (f32.add (f32.load (local.get $y))
        (call $dot64 (local.get $values) (local.get $x) (local.get $columns))))
      (local.set $values (i32.add (local.get $values) (i32.shl (local.get $columns) (i32.const 2))))
      (local.set $y (i32.add (local.get $y) (i32.const 4)))
      (br $row))))

  (func (export "dense_transposed") (param $rows i32) (param $columns i32) (param $values i32)
      (param $x i32) (param $y i32)
    (local $end i32) (local $light f32)
    (local.set $end (i32.add (local.get $x) (i32.shl (local.get $rows) (i32.const 2))))
    (block $done (loop $row
      (br_if $done (i32.ge_u (local.get $x) (local.get $end)))
      (local.set $light (f32.load (local.get $x)))
      (if (f32.ne (local.get $light) (f32.const 0)) (then
        (call $axpy (local.get $y) (local.get $values) (local.get $columns) (local.get $light))))
      (local.set $values (i32.add (local.get $values) (i32.shl (local.get $columns) (i32.const 2))))
      (local.set $x (i32.add (local.get $x) (i32.const 4)))
      (br $row))))

  ;; y[i] += v[i] x[i]
  (func (export "scale") (param $n i32) (param $values i32) (param $x i32) (param $y i32)
    (local $end i32)
    (local.set $end (i32.add (local.get $y) (i32.shl (local.get $n) (i32.const 2))))
    (block $done (loop $next
      (br_if $done (i32.ge_u (local.get $y) (local.get $end)))
      (f32.store (local.get $y) (f32.add (f32.load (local.get $y))
        (f32.mul (f32.load (local.get $values)) (f32.load (local.get $x)))))
      (local.set $y (i32.add (local.get $y) (i32.const 4)))
      (local.set $x (i32.add (local.get $x) (i32.const 4)))
      (local.set $values (i32.add (local.get $values) (i32.const 4)))
      (br $next))))

  ;; y[i] += x[index[i]]
  (func (export "gather") (param $n i32) (param $index i32) (param $x i32) (param $y i32)
    (local $end i32)
    (local.set $end (i32.add (local.get $y) (i32.shl (local.get $n) (i32.const 2))))
    (block $done (loop $next
      (br_if $done (i32.ge_u (local.get $y) (local.get $end)))
      (f32.store (local.get $y) (f32.add (f32.load (local.get $y))
        (f32.load (i32.add (local.get $x) (i32.shl (i32.load (local.get $index)) (i32.const 2))))))
      (local.set $y (i32.add (local.get $y) (i32.const 4)))
      (local.set $index (i32.add (local.get $index) (i32.const 4)))
      (br $next))))

  ;; y[index[i]] += x[i]
  (func (export "gather_transposed") (param $n i32) (param $index i32) (param $x i32) (param $y i32)
    (local $end i32) (local $at i32)
    (local.set $end (i32.add (local.get $x) (i32.shl (local.get $n) (i32.const 2))))
    (block $done (loop $next
      (br_if $done (i32.ge_u (local.get $x) (local.get $end)))
      (local.set $at (i32.add (local.get $y) (i32.shl (i32.load (local.get $index)) (i32.const 2))))
      (f32.store (local.get $at) (f32.add (f32.load (local.get $at)) (f32.load (local.get $x))))
      (local.set $x (i32.add (local.get $x) (i32.const 4)))
      (local.set $index (i32.add (local.get $index) (i32.const 4)))
      (br $next))))
)
