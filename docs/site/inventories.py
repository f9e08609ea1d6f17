"""Where other projects document the names that our signatures have: small inventories for Sphinx's intersphinx.

Their own inventories lie on servers. A build shall not need these, and the names are few.
"""

from __future__ import annotations

import zlib
from pathlib import Path

# Name -> kind and page; $ is the name.
TORCH = {
    "torch.Tensor": ("class", "tensors.html#$"),
    "torch.dtype": ("class", "tensor_attributes.html#torch.dtype"),
    "torch.device": ("class", "tensor_attributes.html#torch.device"),
    "torch.Generator": ("class", "generated/torch.Generator.html#$"),
    "torch.nn.Module": ("class", "generated/torch.nn.Module.html#$"),
    "torch.nn.modules.module.Module": ("class", "generated/torch.nn.Module.html#torch.nn.Module"),
    "torch.nn.Parameter": ("class", "generated/torch.nn.parameter.Parameter.html#torch.nn.parameter.Parameter"),
    "torch.nn.parameter.Parameter": ("class", "generated/torch.nn.parameter.Parameter.html#$"),
    "torch.optim.Optimizer": ("class", "optim.html#$"),
    "torch.optim.optimizer.Optimizer": ("class", "optim.html#torch.optim.Optimizer"),
    "torch.optim.Adam": ("class", "generated/torch.optim.Adam.html#$"),
    "torch.autograd.gradcheck": ("function", "generated/torch.autograd.gradcheck.gradcheck.html"),
    "torch.func.jvp": ("function", "generated/torch.func.jvp.html#$"),
    "torch.func.functional_call": ("function", "generated/torch.func.functional_call.html#$"),
    "torch.nn.utils.parametrize": ("module", "generated/torch.nn.utils.parametrize.register_parametrization.html"),
}
NUMPY = {
    "numpy.ndarray": ("class", "reference/generated/numpy.ndarray.html#$"),
    "numpy.number": ("class", "reference/arrays.scalars.html#$"),
    "numpy.typing.ArrayLike": ("data", "reference/typing.html#$"),
}
PYTHON = {
    "collections.abc.Callable": ("class", "library/collections.abc.html#$"),
    "collections.abc.Iterable": ("class", "library/collections.abc.html#$"),
    "collections.abc.Iterator": ("class", "library/collections.abc.html#$"),
    "collections.abc.Mapping": ("class", "library/collections.abc.html#$"),
    "collections.abc.Sequence": ("class", "library/collections.abc.html#$"),
    "os.PathLike": ("class", "library/os.html#$"),
    "pathlib.Path": ("class", "library/pathlib.html#$"),
    **dict.fromkeys(("int", "float", "bool", "object", "type"), ("class", "library/functions.html#$")),
    **dict.fromkeys(("str", "tuple", "list", "dict", "set", "bytes"), ("class", "library/stdtypes.html#$")),
    **dict.fromkeys(
        "Exception KeyError IndexError OSError RuntimeError RuntimeWarning TypeError UserWarning ValueError".split(),
        ("exception", "library/exceptions.html#$"),
    ),
    "None": ("data", "library/constants.html#$"),
    "types.ModuleType": ("class", "library/types.html#$"),
    "typing.Any": ("data", "library/typing.html#$"),
    "typing.Literal": ("data", "library/typing.html#$"),
    "typing.NamedTuple": ("class", "library/typing.html#$"),
    "typing.Protocol": ("class", "library/typing.html#$"),
}
SITES = {
    "torch": ("https://docs.pytorch.org/docs/stable/", TORCH),
    "numpy": ("https://numpy.org/doc/stable/", NUMPY),
    "python": ("https://docs.python.org/3/", PYTHON),
}


def write_inventories(folder: Path) -> dict[str, tuple[str, str]]:
    """Write them in Sphinx's format (version 2); returns the mapping that intersphinx takes."""
    folder.mkdir(parents=True, exist_ok=True)
    mapping = {}
    for project, (url, names) in SITES.items():
        head = "# Sphinx inventory version 2\n# Project: {}\n# Version: \n"
        head += "# The remainder of this file is compressed using zlib.\n"
        lines = "".join(f"{name} py:{kind} 1 {page} -\n" for name, (kind, page) in names.items())
        path = folder / f"{project}.inv"
        path.write_bytes(head.format(project).encode() + zlib.compress(lines.encode()))
        mapping[project] = (url, str(path))
    return mapping
