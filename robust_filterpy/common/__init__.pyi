from filterpy.common import Q_continuous_white_noise as Q_continuous_white_noise
from filterpy.common import Q_discrete_white_noise as Q_discrete_white_noise
from filterpy.common import Saver as Saver
from filterpy.common import inv_diagonal as inv_diagonal
from filterpy.common import kinematic_state_transition as kinematic_state_transition
from filterpy.common import linear_ode_discretation as linear_ode_discretation
from filterpy.common import order_by_derivative as order_by_derivative
from filterpy.common import outer_product_sum as outer_product_sum
from filterpy.common import pprint as pprint
from filterpy.common import pretty_str as pretty_str
from filterpy.common import reshape_z as reshape_z
from filterpy.common import runge_kutta4 as runge_kutta4
from filterpy.common import van_loan_discretization as van_loan_discretization

from robust_filterpy.common.kinematic import kinematic_kf as kinematic_kf
