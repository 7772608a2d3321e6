/* One control period of the cell: physics steps, the contact's law, the guard.

   The text is compiled behind the struct that plant/memory.py writes. It does what plant/contact.py,
   plant/protection.py, plant/friction.py, plant/encoders.py and plant/tip_mass.py do, operation by
   operation, so that both give the same bits: no operation may be reordered or fused here that is
   not there (-ffp-contract=off). */

enum { OFF, WATCHING, RETRACTING, BRAKED };
enum { LINEAR, SOLID, DENTING };
enum { NONE, HEARTBEAT, JOINT_RANGE, JOINT_SPEED, TIP_SPEED, VELOCITY, ORIENTATION, HEART, FORCE };

typedef void (*mujoco_step)(const void *model, void *data);

static void set_law(memory *m, int axis, double offset, double slope, double slope_speed) {
  double *row = m->law + axis * m->law_stride;
  row[0] = offset;
  row[1] = slope;
  row[2] = slope_speed;
}

static void bond(memory *m) {
  for (int i = 0; i < 3; i++) set_law(m, i, 0.0, -(m->stiffness * m->factor), -m->damping);
}

static void release(memory *m) {
  if (!m->touching) return;
  for (int i = 0; i < 3; i++) set_law(m, i, 0.0, 0.0, 0.0);
  m->touching = m->sticks = 0;
}

static void lean(memory *m) {
  double x = m->length[0], y = m->length[1], z = m->length[2];
  if (z >= 0.0) return release(m);
  if (!m->touching) {
    m->anchor[0] = x;
    m->anchor[1] = y;
    m->touching = 1;
  }
  double stiffness = m->stiffness * m->factor, damping = m->damping;
  double spring = -stiffness * z, damper = -damping * m->speed[2];
  double kept = damper > -spring ? damper : -spring;
  double normal = spring + (kept < spring ? kept : spring);
  double most = m->grip * normal;
  double pull_x = stiffness * (x - m->anchor[0]), pull_y = stiffness * (y - m->anchor[1]);
  double size = sqrt(pull_x * pull_x + pull_y * pull_y);
  int dragged = size > most;
  if (dragged) {
    pull_x = pull_x * most / size;
    pull_y = pull_y * most / size;
    m->anchor[0] = x - pull_x / stiffness;
    m->anchor[1] = y - pull_y / stiffness;
  }
  pull_x = pull_x + damping * m->speed[0];
  pull_y = pull_y + damping * m->speed[1];
  size = sqrt(pull_x * pull_x + pull_y * pull_y);
  int slips = size > most, yields = fabs(damper) > spring;
  if (m->sticks && !(dragged || slips || yields || m->varies)) return;
  if (slips) {
    set_law(m, 0, -pull_x * most / size, 0.0, 0.0);
    set_law(m, 1, -pull_y * most / size, 0.0, 0.0);
  } else {
    set_law(m, 0, stiffness * m->anchor[0], -stiffness, -damping);
    set_law(m, 1, stiffness * m->anchor[1], -stiffness, -damping);
  }
  if (yields)
    set_law(m, 2, normal, 0.0, 0.0);
  else
    set_law(m, 2, 0.0, -stiffness, -damping);
  m->sticks = !(slips || yields);
}

static void relax(memory *m, int elapsed) {
  double place[3] = {m->length[0], m->length[1], m->length[2]};
  double spring = m->stiffness * m->factor, branch = m->relaxing * m->factor;
  if (m->touching) {
    if (elapsed)
      for (int i = 0; i < 3; i++)
        m->strain[i] = m->keeps * m->strain[i] + m->takes * (place[i] - m->before[i]);
  } else {
    if (elapsed) m->strain[2] = m->recovers * m->strain[2];
    double surface = -(m->relaxing / m->stiffness) * m->strain[2];
    if (place[2] < surface) {
      m->touching = 1;
      m->anchor[0] = place[0];
      m->anchor[1] = place[1];
      m->strain[0] = m->strain[1] = 0.0;
      m->strain[2] = m->strain[2] + (place[2] - surface);
    }
  }
  for (int i = 0; i < 3; i++) m->before[i] = place[i];
  if (m->unilateral) {
    if (!m->touching) return;
    double push = -(spring * place[2] + branch * m->strain[2]);
    if (!(push > 0.0)) return release(m);
    double most = m->grip * push;
    double bent_x = place[0] - m->anchor[0], bent_y = place[1] - m->anchor[1];
    double pull_x = spring * bent_x + branch * m->strain[0];
    double pull_y = spring * bent_y + branch * m->strain[1];
    double size = sqrt(pull_x * pull_x + pull_y * pull_y);
    if (size > most) {
      double share = most / size;
      m->anchor[0] = place[0] - share * bent_x;
      m->anchor[1] = place[1] - share * bent_y;
      m->strain[0] = share * m->strain[0];
      m->strain[1] = share * m->strain[1];
    }
  }
  set_law(m, 0, spring * m->anchor[0] - branch * m->strain[0], -spring, 0.0);
  set_law(m, 1, spring * m->anchor[1] - branch * m->strain[1], -spring, 0.0);
  set_law(m, 2, -(branch * m->strain[2]), -spring, 0.0);
}

static void dent(memory *m, int elapsed) {
  double x = m->length[0], y = m->length[1], z = m->length[2];
  if (z >= 0.0) return release(m);
  double move_x = elapsed ? x - m->before[0] : 0.0, move_y = elapsed ? y - m->before[1] : 0.0;
  double bend_x = m->bristle[0], bend_y = m->bristle[1];
  if (!m->touching) {
    m->touching = 1;
    move_x = move_y = bend_x = bend_y = 0.0;
  }
  m->before[0] = x;
  m->before[1] = y;
  m->before[2] = z;
  double speed_x = m->speed[0], speed_y = m->speed[1];
  double elastic = m->coefficient * m->factor;
  elastic = elastic * pow(-z, m->exponent);
  double rate = 1.0 - m->dissipation * m->speed[2];
  int pushes = rate > 0.0;
  double normal = pushes ? elastic * rate : 0.0;
  double stiffness = m->stiffness * m->factor, damping = m->damping;
  double pace = sqrt(speed_x * speed_x + speed_y * speed_y) / m->stribeck_velocity;
  double kinetic = m->kinetic_friction, fixed = m->static_friction;
  double most = (kinetic + (fixed - kinetic) / (1.0 + pace * pace)) * normal;
  double reach = most / stiffness;
  bend_x = bend_x + move_x;
  bend_y = bend_y + move_y;
  double size = sqrt(bend_x * bend_x + bend_y * bend_y);
  double holds = m->break_away * reach;
  if (size > holds && move_x * bend_x + move_y * bend_y > 0.0) {
    double alpha = 1.0;
    if (size < reach) {
      double s = (size - holds) / (reach - holds);
      alpha = s * s * (3.0 - 2.0 * s);
    }
    double way = sqrt(move_x * move_x + move_y * move_y);
    double share = reach / (reach + alpha * way);
    bend_x = share * bend_x;
    bend_y = share * bend_y;
    size = share * size;
  }
  if (size > reach) {
    bend_x = bend_x * reach / size;
    bend_y = bend_y * reach / size;
  }
  m->bristle[0] = bend_x;
  m->bristle[1] = bend_y;
  double pull_x = stiffness * bend_x, pull_y = stiffness * bend_y;
  double total_x = pull_x + damping * speed_x, total_y = pull_y + damping * speed_y;
  size = sqrt(total_x * total_x + total_y * total_y);
  if (size > most) {
    set_law(m, 0, -total_x * most / size, 0.0, 0.0);
    set_law(m, 1, -total_y * most / size, 0.0, 0.0);
  } else {
    set_law(m, 0, -pull_x, 0.0, -damping);
    set_law(m, 1, -pull_y, 0.0, -damping);
  }
  if (pushes)
    set_law(m, 2, elastic, 0.0, -(elastic * m->dissipation));
  else
    set_law(m, 2, 0.0, 0.0, 0.0);
}

static void follow(memory *m, int elapsed) {
  if (elapsed) m->factor += m->factor_step;
  if (m->kind == SOLID)
    relax(m, elapsed);
  else if (m->kind == DENTING)
    dent(m, elapsed);
  else if (m->unilateral)
    lean(m);
  else
    bond(m);
}

static double force_size(const memory *m) {
  double square = 0.0;
  for (int i = 0; i < 3; i++) {
    const double *row = m->law + i * m->law_stride;
    double along = row[1] * m->length[i] + row[2] * m->speed[i] + row[0];
    square += along * along;
  }
  return sqrt(square);
}

static void trip(memory *m, int cause, int joint, double value, double limit) {
  m->mode = RETRACTING;
  m->cause = cause;
  m->joint = joint;
  m->value = value;
  m->limit = limit;
  m->unilateral = m->renewed = 1;
  m->depth = -m->length[2];
  for (int i = 0; i < 3; i++) {
    m->normal[i] = m->surface_frame[3 * i + 2];
    m->tip_tripped[i] = m->tip[i];
  }
  for (int i = 0; i < JOINTS; i++) {
    m->goal[i] = m->motor[i];
    m->goal_speed[i] = 0.0;
  }
}

static void watch(memory *m, int64_t step) {
  m->step = step;
  const double *q = m->qpos + HEART_JOINTS, *speeds = m->qvel + HEART_JOINTS;
  double square = 0.0, error = 0.0, turned = 0.0;
  for (int i = 0; i < 3; i++) {
    double v = (m->tip[i] - m->tip_before[i]) / m->timestep;
    m->tip_before[i] = m->tip[i];
    m->expected[i] = m->decay * m->expected[i] + m->gain * m->asked[i];
    square += v * v;
    error += (v - m->expected[i]) * (v - m->expected[i]);
  }
  for (int i = 0; i < HEART_JOINTS; i++) m->heart[i] += m->heart_step[i];
  for (int i = 0; i < 9; i++) {
    double difference = m->tip_frame[i] - m->frame_held[i];
    turned += difference * difference;
  }

  for (int i = 0; i < JOINTS; i++) {
    double travel = m->stopping[i] * speeds[i] * speeds[i] + m->reaction * fabs(speeds[i]);
    double high = speeds[i] > 0.0 ? q[i] + travel : q[i];
    double low = speeds[i] < 0.0 ? q[i] - travel : q[i];
    if (!(high <= m->upper[i])) return trip(m, JOINT_RANGE, i, high, m->upper[i]);
    if (!(low >= m->lower[i])) return trip(m, JOINT_RANGE, i, low, m->lower[i]);
  }
  for (int i = 0; i < JOINTS; i++)
    if (!(fabs(speeds[i]) <= m->joint_speed[i]))
      return trip(m, JOINT_SPEED, i, fabs(speeds[i]), m->joint_speed[i]);
  if (!(sqrt(square) <= m->tip_speed)) return trip(m, TIP_SPEED, -1, sqrt(square), m->tip_speed);
  if (!(sqrt(error) <= m->tracking_velocity))
    return trip(m, VELOCITY, -1, sqrt(error), m->tracking_velocity);
  if (!(sqrt(turned) <= m->tracking_orientation))
    return trip(m, ORIENTATION, -1, sqrt(turned), m->tracking_orientation);
  for (int i = 0; i < HEART_JOINTS; i++)
    if (!(fabs(m->qpos[i] - m->heart[i]) <= m->tracking_heart))
      return trip(m, HEART, i, fabs(m->qpos[i] - m->heart[i]), m->tracking_heart);
  double force = force_size(m);
  if (!(force <= m->force)) trip(m, FORCE, -1, force, m->force);
}

static void retract(memory *m) {
  const double *q = m->motor, *speeds = m->motor_speed;
  double wanted[JOINTS], torque[JOINTS], share = 1.0;
  for (int i = 0; i < JOINTS; i++) {
    double goal = m->goal[i] + m->goal_speed[i] * m->timestep;
    if (goal > q[i] + m->leash) goal = q[i] + m->leash;
    if (goal < q[i] - m->leash) goal = q[i] - m->leash;
    if (goal > m->goal_upper[i]) goal = m->goal_upper[i];
    if (goal < m->goal_lower[i]) goal = m->goal_lower[i];
    m->goal[i] = goal;
    wanted[i] = m->stiff * (goal - q[i]) + m->damp * (m->goal_speed[i] - speeds[i]);
  }
  for (int i = 0; i < JOINTS; i++) {
    torque[i] = 0.0;
    for (int j = 0; j < JOINTS; j++) torque[i] += m->inertia[JOINTS * i + j] * wanted[j];
    double room = m->torque_limit[i] - (torque[i] > 0.0 ? m->bias[i] : -m->bias[i]);
    if (!(room > 0.0)) room = 0.0;
    if (share * fabs(torque[i]) > room) share = room / fabs(torque[i]);
  }
  for (int i = 0; i < JOINTS; i++) m->ctrl[i] = m->bias[i] + share * torque[i];
}

static void renew_friction(memory *m) {
  for (int i = 0; i < JOINTS; i++) {
    double share = m->motor_speed[i] / m->stribeck_speed;
    m->frictionloss[i] = m->coulomb[i] + m->excess[i] / (1.0 + share * share);
  }
}

static void read_encoders(memory *m) {
  for (int i = 0; i < JOINTS; i++) {
    double angle = m->motor[i];
    if (m->resolution != 0.0) angle = rint(angle / m->resolution) * m->resolution;
    double slope = (angle - m->encoder_angle[i]) / m->timestep;
    m->encoder_speed[i] += m->speed_share * (slope - m->encoder_speed[i]);
    m->encoder_angle[i] = angle;
  }
}

static void remember_tip(memory *m) {
  for (int i = 0; i < 3; i++) {
    m->tip_passed[3 + i] = m->tip_passed[i];
    m->tip_passed[i] = m->tip[i];
  }
}

void advance(memory *m, mujoco_step step1, mujoco_step step2, const void *model, void *data) {
  for (int64_t i = 0; i < m->substeps; i++) {
    if (m->heavy) remember_tip(m);
    step2(model, data);
    if (m->stribeck) renew_friction(m);
    if (m->encoded) read_encoders(m);
    step1(model, data);
    if (m->renewed) follow(m, 1);
    double force = force_size(m);
    if (!(force <= m->peak)) m->peak = force;
    if (m->mode == WATCHING) {
      watch(m, i + 1);
      if (m->mode == RETRACTING) follow(m, 0);  /* released at once */
    }
    if (m->mode == RETRACTING) retract(m);
  }
}
