/* When readings are taken that arrive late, and which clone stands for one. clones.py is the same; keep both in step. */

static void update_lag(double *m, int c) {
  double age = m_now[0] - m_stamp[c];
  if (age > 1.5 * m_dt[0] + EARLY && age > m_lag[c]) m_lag[c] = smaller_of(age, LONGEST_LAG);
}

/* Time between two clones at least: motion is smooth enough in between. Joints have no need to save. */
static double least_apart(int c) { return c < N_VEHICLE ? SPACING * orders_of[c] : 0; }

static double wanted(const double *m, int c) {
  double apart = larger_of(larger_of(m_period[c], m_dt[0]), larger_of(least_apart(c), EARLY));
  return (m_lag[c] + 2.0 * m_dt[0]) / apart + 1.0;
}

static void space_clones(double *m, int first, int last, int slots) {
  double most = MOST_CLONES, sum = slots + 1;
  for (; most > 2; most -= 1) {
    sum = 0;
    for (int c = first; c < last; ++c)
      if (m_lag[c] > 0) sum += smaller_of(most, wanted(m, c));
    if (sum <= slots) break;
  }
  for (int c = first; c < last; ++c)
    if (m_lag[c] > 0)
      m_apart[c] = larger_of(larger_of(m_period[c], least_apart(c)), (m_lag[c] + 2.0 * m_dt[0]) / (most - 1.0));
}

/* The clone for the fresh reading of channel c, -1 for now; true if it is near enough. */
static int nearest(const double *m, int c, const double *owner, const double *taken, int slots, int *best, double *delta) {
  double reach = 1.5 * m_dt[0] + EARLY;
  *best = -1, *delta = m_stamp[c] - m_now[0];
  for (int slot = 0; slot < slots; ++slot)
    if (owner[slot] == c && fabs(m_stamp[c] - taken[slot]) < fabs(*delta)) *best = slot, *delta = m_stamp[c] - taken[slot];
  if (*best >= 0) reach += m_apart[c];
  return fabs(*delta) <= reach;
}

static int is_due(double *m, int c) {
  if (m_lag[c] <= 0 || m_now[0] < m_due[c] - EARLY) return 0;
  double apart = m_apart[c], period = m_period[c], phase = isfinite(m_last[c]) ? m_last[c] : 0;
  if (apart <= m_dt[0] + EARLY) m_due[c] = m_now[0];
  else if (period <= m_dt[0]) m_due[c] = m_now[0] + apart;
  else m_due[c] = phase + (floor((m_now[0] - phase) / period + 1e-6) + ceil(apart / period - 1e-6)) * period;
  return 1;
}

static void expire(const double *m, int c, double *owner, const double *taken, int slots) {
  for (int slot = 0; slot < slots; ++slot) {
    int old = m_now[0] - taken[slot] > m_lag[c] + 2.0 * m_dt[0] + EARLY || taken[slot] <= m_last[c] + EARLY;
    if (owner[slot] == c && old) owner[slot] = -1;
  }
}

static int free_slot(const double *owner, int slots) {
  for (int slot = 0; slot < slots; ++slot)
    if (owner[slot] < 0) return slot;
  return -1;
}

/* Time in which the robot can have done something else since the last reading that was believed. */
static double time_since_accepted(const double *m, int c) { return smaller_of(m_stamp[c] - m_used[c], LONGEST_LAG) + SURPRISE; }

static double gate_allowance(const double *m, int c) {
  double elapsed = time_since_accepted(m, c), moved = m_agility[c];
  for (int i = 0; i < orders_of[c]; ++i) moved *= elapsed;
  moved /= orders_of[c] > 1 ? orders_of[c] : 1;
  return moved * moved / 25.0;
}

static void note(double *m, int c, double squared, double degrees, int believed) {
  double *outcome = m_outcome + 4 * c;
  outcome[0] = m_stamp[c], outcome[1] = squared, outcome[2] = degrees, outcome[3] = believed;
  if (believed) m_used[c] = m_stamp[c];
}

static int is_of_now(const double *m, int c) { return m_last[c] < m_stamp[c] && m_stamp[c] <= m_now[0] + EARLY; }
