// Speed of the simulator Enki in robot-seconds per second of processor time: enki_steps ROBOTS.
// benchmarks/peers.py compiles it against Debian's libenki-dev. E-pucks with eight infrared rays of
// 12 cm avoid obstacles in an arena of 1 m2 a robot, in steps of 0.1 s with three of the physics.
// Prints the speed of each sample.
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <memory>
#include <vector>

#include <enki/PhysicalEngine.h>
#include <enki/robots/e-puck/EPuck.h>

int main(int count, char **words) {
    const int robots = count > 1 ? std::atoi(words[1]) : 7;
    const double side = 100.0 * std::sqrt(robots) + 10.0; // cm
    Enki::World world(side, side);
    std::vector<std::unique_ptr<Enki::EPuck>> pucks;
    std::srand(0);
    const auto draw = [](double most) { return most * std::rand() / RAND_MAX; };
    for (int i = 0; i < robots; ++i) {
        auto puck = std::make_unique<Enki::EPuck>(
            Enki::EPuck::CAPABILITY_BASIC_SENSORS);
        puck->pos = Enki::Point(10.0 + draw(side - 20.0), 10.0 + draw(side - 20.0));
        puck->angle = draw(2.0 * M_PI);
        world.addObject(puck.get());
        pucks.push_back(std::move(puck));
    }
    const double step = 0.1;          // s
    const auto advance = [&](int steps) {
        for (int i = 0; i < steps; ++i) {
            for (auto &puck : pucks) {
                const bool near = puck->infraredSensor0.getDist() < 8.0 ||
                                  puck->infraredSensor7.getDist() < 8.0;
                puck->leftSpeed = near ? 4.0 : 8.0; // cm/s
                puck->rightSpeed = near ? -4.0 : 8.0;
            }
            world.step(step, 3);
        }
    };
    advance(10);
    for (int sample = 0; sample < 5; ++sample) {
        const std::clock_t start = std::clock();
        int steps = 0;
        while (std::clock() - start < CLOCKS_PER_SEC / 2) {
            advance(1);
            ++steps;
        }
        const double seconds = double(std::clock() - start) / CLOCKS_PER_SEC;
        std::printf("%g\n", robots * steps * step / seconds);
    }
    for (auto &puck : pucks)
        world.removeObject(puck.get());
}
