$rule
$?expected     rule.expected = model->expected;
$?may_be_linear     rule.scaling = real_is_finite(model->threshold) ? SCALING_LEARNT : SCALING_INNOVATION;
