#pragma once

/// What the page's script calls: the one World there is, through numbers and one shared array of
/// doubles. Points in the array are x, y. Support and method are indices, as in world.h.
///
/// A call that fails returns -1, and page_error() says why. Nothing here is for several threads.
extern "C" {

/// Scenes and methods as JSON text, valid until the next call.
const char* page_describe();
const char* page_error();
/// The shared array, with room for at least `count` doubles. Valid until it is asked for more.
double* page_array(int count);

int page_open(int scene);
/// Adds demonstrations. @returns how many there are.
int page_demonstrate(int count, int seed);
/// `points` points of the array are a line that a user drew; see World::Draw().
int page_draw(int points, int repeats, int seed);
int page_clear();
/// Writes demonstration `index` to the array. @returns its number of points.
int page_demonstration(int index);
/// Fits all but what the certified method needs.
int page_fit();
/// Fits that, too. Every call that needs it does so itself, where it has not been done.
int page_fit_certified();
/// Time steps that have an estimate of their own.
int page_num_steps(int support);

/// l_t at columns x rows points of a grid, row by row from (left, top), `spacing` apart and
/// downwards, to the array.
int page_levels(int support, int t, double left, double top, double spacing, int columns, int rows);
/// To the array: l_t, g_t, x and y of the safe disc's centre and its radius;
/// the last three are NaN before the fit of the certified method.
int page_look(int support, int t, double x, double y);
int page_nearest_step(int support, double x, double y);

/// Begins an episode at (x, y) in this time step.
int page_start(int method, double x, double y, int first_step, int seed);
/// A start state of the scene, to the array.
int page_start_state(int seed);
/// One control. To the array: x, y before; x, y after; x, y where the policy wanted to; mode; time
/// step; g; threshold; 1 if the policy's control was changed; 1 if it is certified; outcome (-1
/// while under way); halt cause.
int page_step();
/// Moves the robot of the episode, which does not know why.
int page_displace(double x, double y);
/// Pushes the policy's controls by a motion.
int page_push(double dx, double dy);
/// The way of an episode of its own, of at most `most` controls, as points in the array. @returns
/// how many; the outcome is behind them, -1 where it is still under way.
int page_preview(int method, double x, double y, int first_step, int most);
/// Episodes from random start states. To the array: completed, halted, collided.
int page_run(int method, int count, int seed);
}
