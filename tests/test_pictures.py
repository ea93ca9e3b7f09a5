"""The bundled pictures are the ones that their script makes."""

import numpy as np
import pytest

from experiments.pictures.make import make
from softras2d import pictures
from softras2d.io.images import read_image


@pytest.mark.parametrize("name", pictures.names())
def test_pictures_are_what_the_script_makes(name):
    image = read_image(pictures.path(name))
    assert image.shape == (*pictures.size(name), 3)
    assert image.std() > 0.1
    # Sines may differ in the last bit between machines, which may round to another level.
    assert np.abs(image - make(name)).max() < 1.6 / 255


def test_an_unknown_picture_is_named():
    for function in (pictures.path, pictures.size):
        with pytest.raises(ValueError, match="no bundled picture 'sea'; there are valley, fruit"):
            function("sea")
