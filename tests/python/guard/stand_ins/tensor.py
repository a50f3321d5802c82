"""A tensor that behaves like torch's where arrays and tensors differ."""

import numpy as np


class Tensor:
    """NumPy cannot read the data on a device other than the CPU, and size is a method."""

    def __init__(self, values, device="cpu"):
        self._values = np.asarray(values)
        self.device = device

    @property
    def shape(self):
        return self._values.shape

    @property
    def dtype(self):
        return self._values.dtype

    def size(self):
        return self.shape

    def detach(self):
        return Tensor(self._values, self.device)

    def cpu(self):
        return Tensor(self._values)

    def double(self):
        return Tensor(self._values.astype(np.float64), self.device)

    def is_floating_point(self):
        return np.issubdtype(self._values.dtype, np.floating)

    def item(self):
        return self._values.item()

    def numpy(self):
        if self.device != "cpu":
            raise TypeError(f"can't convert a tensor on {self.device} to numpy")
        return self._values

    def __array__(self, dtype=None):
        return self.numpy() if dtype is None else self.numpy().astype(dtype)

    def new_tensor(self, values):
        return Tensor(np.asarray(values, dtype=self.dtype), self.device)

    def __getitem__(self, index):
        return Tensor(self._values[index], self.device)
