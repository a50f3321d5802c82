#pragma once

/// Functions for the page's script. They access the single World through numbers and one shared
/// array of doubles. Points in the array are x, y. Support and method are indices, as in world.h.
///
/// A call that fails returns -1; page_error() returns the reason. Use one thread only.
extern "C" {

/// Returns the scenes, methods, halt causes and gain as JSON text, valid until the next call.
const char* page_describe();
const char* page_error();
/// Returns the shared array of at least `count` doubles, valid until a larger one is requested.
double* page_array(int count);

int page_open(int scene);
/// Adds demonstrations. @returns their total number.
int page_demonstrate(int count, int seed);
/// Takes `points` points of the array as a line drawn by the user; see World::Draw().
int page_draw(int points, int repeats, int seed);
int page_clear();
/// Writes demonstration `index` to the array. @returns its number of points.
int page_demonstration(int index);
/// Fits everything except the certified method's parts.
int page_fit();
/// Fits the certified method's parts. Calls that need these parts also fit them.
int page_fit_certified();
/// Returns the number of time steps with a separate estimate.
int page_num_steps(int support);

/// Writes l_t at columns x rows points of a grid to the array, row by row downwards from (left,
/// top), `spacing` apart.
int page_levels(int support, int t, double left, double top, double spacing, int columns, int rows);
/// Writes l_t, g_t, x and y of the safe disc's centre, and its radius to the array. The last three
/// are NaN before the fit of the certified method.
int page_look(int support, int t, double x, double y);
int page_nearest_step(int support, double x, double y);

/// Begins an episode at (x, y) at this time step.
int page_start(int method, double x, double y, int first_step, int seed);
/// Writes a start state of the scene to the array.
int page_start_state(int seed);
/// Applies one control. Writes to the array: x, y before; x, y after; x, y of the policy's target;
/// mode; time step; g; threshold; 1 if the policy's control was changed; 1 if the control is
/// certified; outcome (-1 while running); halt cause.
int page_step();
/// Moves the robot of the episode without informing the controller.
int page_displace(double x, double y);
/// Adds a motion to the policy's controls.
int page_push(double dx, double dy);
/// Runs a separate episode of at most `most` controls and writes its path to the array. @returns
/// the number of points; the outcome follows them, -1 if the episode is not over.
int page_preview(int method, double x, double y, int first_step, int most);
/// Runs episodes from random start states. Writes completed, halted and collided to the array.
int page_run(int method, int count, int seed);
}
