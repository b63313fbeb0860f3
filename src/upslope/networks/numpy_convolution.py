"""The 3 × 3 convolution (stride 1, SAME padding) in NumPy, for code that runs on the host. Needs no JAX."""

import numpy as np
from jaxtyping import Float

#: The number of kernels in each convolutional layer (Sec. 5.2).
CHANNELS = (32, 32, 32, 32)


def convolve(
    images: Float[np.ndarray, "n height width inputs"], kernel: Float[np.ndarray, "3 3 inputs outputs"]
) -> Float[np.ndarray, "n height width outputs"]:
    """One matrix product with the neighbourhoods of all cells; zero beyond the border."""
    height, width = images.shape[1:3]
    padded = np.pad(images, [(0, 0), (1, 1), (1, 1), (0, 0)])
    windows = [padded[:, row : row + height, column : column + width] for row in range(3) for column in range(3)]
    return np.concatenate(windows, axis=-1) @ kernel.reshape(-1, kernel.shape[-1])
