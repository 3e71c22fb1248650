"""Does one kernel for a whole network pay? A gradient and a forward pass, by XLA and in Pallas.

    python experiments/03_speed/fused.py

Each program of the forward kernel takes a block of rows through all layers; activations before their
nonlinearity go to memory for the backward kernel, which writes its block's share of the weights'
gradient. Layers wider than 128 are computed in chunks of 64 units. Needs a GPU, bfloat16. kernel.md has
the result: it does not pay.
"""

import functools
import time

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import pallas as pl
from jax.experimental.pallas import triton

from dynappo.learner.networks import elu

BF16, F32 = jnp.bfloat16, jnp.float32
CASES = {  # sizes, networks side by side, rows of a gradient
    "actor and critic": ((48, 128, 128, 128, 12), 2, 5120),
    "actor and critic, 4096 robots": ((48, 128, 128, 128, 12), 2, 20480),
    "model": ((64, 256, 256, 256, 256, 50), 1, 2048),
}
BLOCKS = (32, 4), (64, 4), (64, 8), (128, 8)  # rows, warps
STEPS, ROWS = 20, 1024


def chunks(size):
    step = 64 if size > 128 else size
    return [slice(at, at + step) for at in range(0, size, step)]


def forward(*refs, layers):
    x_ref, weights, biases = refs[0], refs[1 : 1 + layers], refs[1 + layers : 1 + 2 * layers]
    outputs = *refs[2 + 2 * layers :], refs[1 + 2 * layers]  # before each activation; the last
    x = x_ref[...]
    for weight, bias, output in zip(weights, biases, outputs, strict=True):
        for part in chunks(output.shape[-1]):
            output[:, part] = (triton.dot(x, weight[:, part]) + bias[part][None]).astype(
                output.dtype
            )
        if output is not outputs[-1]:
            triton.debug_barrier()  # the block's own rows are read again
            x = elu(output[...].astype(F32)).astype(BF16)


def backward(*refs, layers):
    x_ref, slope, weights = refs[0], refs[1], refs[2 : 2 + layers]
    before, found = refs[2 + layers : 1 + 2 * layers], refs[1 + 2 * layers :]
    d_weights, d_biases, slopes = found[:layers], found[layers : 2 * layers], found[2 * layers :]
    for k in reversed(range(layers)):
        x = elu(before[k - 1][...].astype(F32)).astype(BF16) if k else x_ref[...]
        for part in chunks(slope.shape[-1]):
            d_weights[k][:, part] = triton.dot(x, slope[:, part], trans_a=True)
            d_biases[k][part] = slope[:, part].astype(F32).sum(0)
        if k == 0:
            return
        rows = slope[...]
        for part in chunks(weights[k].shape[0]):
            z = before[k - 1][:, part].astype(F32)
            passed = triton.dot(rows, weights[k][part, :], trans_b=True)
            passed *= jnp.where(z > 0, 1.0, jnp.exp(jnp.minimum(z, 0)))
            slopes[k - 1][:, part] = passed.astype(BF16)
        triton.debug_barrier()
        slope = slopes[k - 1]


def call(kernel, grid, block, inputs, outputs, name):
    """`kernel` over `(network, block of rows)`; of an array's axes, "k" is a network, "r" rows and "b" a
    block's share."""
    rows, warps = block

    def spec(axes, shape):
        sizes = [rows if a == "r" else None if a in "kb" else n for a, n in zip(axes, shape)]  # noqa: B905
        return pl.BlockSpec(
            tuple(sizes), lambda k, i: tuple({"k": k, "r": i, "b": i}.get(a, 0) for a in axes)
        )

    return pl.pallas_call(
        kernel,
        grid=grid,
        in_specs=[spec(axes, x.shape) for axes, x in inputs],
        out_specs=[spec(axes, x.shape) for axes, x in outputs],
        out_shape=[x for _, x in outputs],
        compiler_params=triton.CompilerParams(num_warps=warps, num_stages=1),
        name=name,
    )(*(x for _, x in inputs))


def shape(*sizes, dtype=F32):
    return jax.ShapeDtypeStruct(sizes, dtype)


@functools.partial(jax.custom_vjp, nondiff_argnums=(2,))
def fused(params, x, block):
    return fused_forward(params, x, block)[0]


def padded(x):
    """With its last axis, of weights both, a power of two."""
    sizes = [0] * (x.ndim - 2) + [1 << (n - 1).bit_length() for n in x.shape[-2:]]
    sizes[-2] = sizes[-2] if x.ndim == 3 else x.shape[-2]
    return jnp.pad(
        x.astype(BF16), [(0, max(0, m - n)) for m, n in zip(sizes, x.shape, strict=True)]
    )


def fused_forward(params, x, block):
    x, weights, biases = (
        padded(x),
        *([padded(p) for p in part] for part in zip(*params, strict=True)),
    )
    count, rows, layers = len(weights[0]), len(x), len(weights)
    inputs = [("rx", x), *(("kio", w) for w in weights), *(("ko", b) for b in biases)]
    outputs = [("kro", shape(count, rows, weights[-1].shape[-1]))]
    outputs += [("kro", shape(count, rows, w.shape[-1], dtype=BF16)) for w in weights[:-1]]
    kernel = functools.partial(forward, layers=layers)
    y, *before = call(kernel, (count, rows // block[0]), block, inputs, outputs, "mlp")
    return y[..., : params[-1][0].shape[-1]], (params, x, weights, before)


def fused_backward(block, kept, slope):
    params, x, weights, before = kept
    count, layers, blocks = len(weights[0]), len(weights), len(x) // block[0]
    slope = padded(slope.reshape(-1, slope.shape[-1])).reshape(count, len(x), -1)
    inputs = [("rx", x), ("kro", slope), *(("kio", w) for w in weights)]
    inputs += [("kro", z) for z in before]
    outputs = [("kbio", shape(count, blocks, *w.shape[1:])) for w in weights]
    outputs += [("kbo", shape(count, blocks, w.shape[-1])) for w in weights]
    outputs += [("kro", shape(*z.shape, dtype=BF16)) for z in before]
    kernel = functools.partial(backward, layers=layers)
    found = call(kernel, (count, blocks), block, inputs, outputs, "mlp_backward")
    sums = [part.sum(1) for part in found[: 2 * layers]]
    own = [(w[:, : p.shape[1], : p.shape[2]], b[:, : p.shape[2]]) for w, b, (p, _) in
           zip(sums[:layers], sums[layers:], params, strict=True)]  # fmt: skip
    return own, None  # nobody asks for the observation's


fused.defvjp(fused_forward, fused_backward)


def plain(params, x, _=None):
    """As `fast.actor_critic`: a product a layer, of all networks."""
    x = jnp.broadcast_to(x.astype(BF16), (len(params[0][0]), *x.shape))
    for i, (weight, bias) in enumerate(params):
        last = i == len(params) - 1
        kind = F32 if last else None
        x = jnp.einsum("kri,kio->kro", x, weight.astype(BF16), preferred_element_type=kind)
        x = x + bias.astype(BF16)[:, None]
        x = x if last else elu(x)
    return x.astype(F32)


def network(sizes, count, key):
    def layer(key, size):
        return [
            jax.random.uniform(k, (count, *s), minval=-1, maxval=1) / size[0] ** 0.5
            for k, s in zip(jax.random.split(key), (size, size[1:]), strict=True)
        ]

    pairs = list(zip(sizes, sizes[1:], strict=False))
    keys = jax.random.split(key, len(pairs))
    return [tuple(layer(k, s)) for k, s in zip(keys, pairs, strict=True)]


def microseconds(function, *args):
    function = jax.jit(function)
    jax.block_until_ready(function(*args))
    times = []
    for _ in range(7):
        began = time.perf_counter()
        jax.block_until_ready(function(*args))
        times.append(time.perf_counter() - began)
    return np.median(times) * 1e6 / STEPS


def main():
    keys = jax.random.split(jax.random.key(0), 3)
    for name, (sizes, count, rows) in CASES.items():
        params = network(sizes, count, keys[0])
        x, y = (jax.random.normal(k, s) for k, s in
                zip(keys[1:], ((rows, sizes[0]), (count, rows, sizes[-1])), strict=True))  # fmt: skip
        for how, block in (("XLA", None), *(("fused", block) for block in BLOCKS)):
            if count == 1 and block == (128, 8):
                continue  # more shared memory than there is
            net = plain if block is None else fused

            def loss(params, x, y, net=net, block=block):
                return ((net(params, x, block) - y) ** 2).mean()

            def descend(params, x, y, loss=loss):
                def step(params, _):
                    grads = jax.grad(loss)(params, x, y)
                    return jax.tree.map(lambda p, g: p - 1e-3 * g, params, grads), None

                return jax.lax.scan(step, params, None, length=STEPS)[0]

            def act(params, x, net=net, block=block):
                def step(x, _):
                    return x + 1e-6 * net(params, x, block).sum(0).mean(-1, keepdims=True), None

                return jax.lax.scan(step, x, None, length=STEPS)[0]

            taken = microseconds(descend, params, x, y), microseconds(act, params, x[:ROWS])
            print(
                f"{name:30s} {how:6s} {block or ''!s:10s} {taken[0]:7.1f} {taken[1]:7.1f} us",
                flush=True,
            )


if __name__ == "__main__":
    main()
