// Speed of the simulator Enki: enki_steps ROBOTS RAYS RANGE NEAR SECONDS, lengths in m.
// benchmarks/rivals/__main__.py compiles it against Debian's libenki-dev, or against $ENKI.
// Prints the simulated robot-seconds and their CPU seconds. Robots with two wheels, the body of a Waffle
// Pi as a disc and a camera all around whose depths are the rays; the physics has three steps of 1/30 s.
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <memory>
#include <vector>

#include <enki/PhysicalEngine.h>
#include <enki/interactions/CircularCam.h>
#include <enki/robots/DifferentialWheeled.h>

const double CM = 100.0;        // in a metre; Enki counts in cm and kg
const double STEP = 0.1;        // s
const double WHEEL_BASE = 28.7; // cm, of a Waffle Pi
const double SPEED = 20.0;      // cm/s
const double TURN = 1.0;        // rad/s
const double AHEAD = 1.0;       // rad to each side

// With the default, in which both halves end at a right angle, the tangents of Enki's rays overflow.
class Rays : public Enki::OmniCam {
public:
    Rays(Enki::Robot *owner, int count) : OmniCam(owner, 5.0, count / 2) {
        cam0.halfFieldOfView = M_PI / 2.0 - M_PI / count;
        cam1.halfFieldOfView = cam0.halfFieldOfView;
    }
};

class Walker : public Enki::DifferentialWheeled {
public:
    Rays camera;

    Walker(int rays, double range) : DifferentialWheeled(WHEEL_BASE, 30.0, 0.0), camera(this, rays) {
        camera.setRange(range);
        addLocalInteraction(&camera);
        setCylindric(15.0, 10.0, 1.8);
    }

    void decide(double near) {
        const int rays = camera.zbuffer.size(); // squares of distances, from -pi on
        bool is_near = false;
        for (int ray = 0; ray < rays; ++ray) {
            const double bearing = -M_PI + 2.0 * M_PI * (ray + 0.5) / rays;
            is_near = is_near || (std::fabs(bearing) < AHEAD && camera.zbuffer[ray] < near * near);
        }
        const double turn = TURN * WHEEL_BASE / 2.0;
        leftSpeed = is_near ? -turn : SPEED;
        rightSpeed = is_near ? turn : SPEED;
    }
};

int main(int count, char **words) {
    if (count != 6)
        return 2;
    const int robots = std::atoi(words[1]);
    const int rays = std::atoi(words[2]);
    const double range = CM * std::atof(words[3]);
    const double near = CM * std::atof(words[4]);
    const double seconds = std::atof(words[5]);
    const double side = CM * std::sqrt(robots) + 10.0;
    Enki::World world(side, side);
    std::vector<std::unique_ptr<Walker>> walkers;
    const int columns = std::ceil(std::sqrt(robots));
    std::srand(0);
    for (int index = 0; index < robots; ++index) {
        auto walker = std::make_unique<Walker>(rays, range);
        walker->pos = Enki::Point((index % columns + 0.5) * side / columns, (index / columns + 0.5) * side / columns);
        walker->angle = 2.0 * M_PI * std::rand() / RAND_MAX;
        world.addObject(walker.get());
        walkers.push_back(std::move(walker));
    }
    double taken = 0.0;
    const auto advance = [&](double least) {
        const std::clock_t start = std::clock();
        int steps = 0;
        while ((taken = double(std::clock() - start) / CLOCKS_PER_SEC) < least) {
            world.step(STEP, 3);
            for (auto &walker : walkers)
                walker->decide(near);
            ++steps;
        }
        return steps;
    };
    advance(seconds / 2.0);
    const int steps = advance(seconds);
    std::printf("%g %g\n", robots * steps * STEP, taken);
    for (auto &walker : walkers)
        world.removeObject(walker.get());
}
