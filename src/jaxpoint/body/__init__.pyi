from .following import Following as Following, follow as follow
from .arm import ArmReason as ArmReason, ArmView as ArmView, PointingArm as PointingArm
from .joints import Joints as Joints
from .limb_axis import LimbAxis as LimbAxis, fit_axis as fit_axis
