"""In which precision the layers compute: bfloat16 where the machine does so natively, float32 where it would only emulate it.

>>> import torch
>>> resolve_precision("float32", torch.device("cpu"))
'float32'
"""

import platform
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:  # a configuration names a precision without loading torch
    import torch

Precision = Literal["auto", "bfloat16", "float32"]
"""auto: bfloat16 where the device computes it natively, float32 elsewhere."""
Resolved = Literal["bfloat16", "float32"]

COST_OF_EMULATION = "a training update takes about eight times as long as in float32, a plan about four times"
"""Measured on two AVX2 cores (docs/log.md)."""


def computes_bfloat16(device: "torch.device") -> bool:
    """Whether the device multiplies numbers in bfloat16 by instructions of its own: AVX-512 bf16, AMX, Arm bf16, CUDA from Ampere on."""
    import torch

    if device.type == "cuda":
        with torch.cuda.device(device):
            return torch.cuda.is_bf16_supported(including_emulation=False)
    # Absent where torch was built without oneDNN. It answers yes to all of AVX-512, whose first generations emulate.
    by_library = getattr(torch.ops.mkldnn, "_is_mkldnn_bf16_supported", None)
    by_processor = getattr(torch.cpu, "_is_avx512_bf16_supported", None) if platform.machine() in ("x86_64", "AMD64") else None
    return device.type == "cpu" and by_library is not None and by_library() and (by_processor is None or by_processor())


def resolve_precision(precision: Precision, device: "torch.device") -> Resolved:
    """The precision to compute in on this device; what is asked for by name stays as it is."""
    if precision != "auto":
        return precision
    return "bfloat16" if computes_bfloat16(device) else "float32"


def describe_precision(precision: Precision, device: "torch.device") -> str:
    """The choice in one line, with its reason, and with its cost where the device emulates what was asked for."""
    resolved, native = resolve_precision(precision, device), computes_bfloat16(device)
    name = "GPU" if device.type == "cuda" else "processor"
    if resolved == "bfloat16" and not native:
        reason = f"this {name} emulates it: {COST_OF_EMULATION}; --precision auto takes float32"
    elif precision != "auto":
        reason = "as asked for"
    else:
        reason = f"this {name} computes it natively" if native else f"this {name} would only emulate bfloat16"
    return f"precision: {resolved} ({reason})"
