"""Feature parametrisations of one contract; `features.parametrisation` chooses among them."""

from gyrocal_ros.model.features.base import Parametrisation
from gyrocal_ros.model.features.camera_frame import CameraFramePoint
from gyrocal_ros.model.features.inverse_depth import AnchoredInverseDepth
from gyrocal_ros.model.features.pixel import PixelPoint

PARAMETRISATIONS: dict[str, Parametrisation] = {
    item.name: item for item in (AnchoredInverseDepth(), CameraFramePoint(), PixelPoint())
}
